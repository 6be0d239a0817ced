"""Numbers out of serialised messages (CDR), many at once: messages with texts of the same lengths have one layout.

One message is walked field by field, and the others of its layout are read as columns of an array: a hundred times
quicker than message by message, and what does not end where the message ends is no such message.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil_gateway.process.arrays import Array

Definitions = Mapping[str, tuple[Any, Sequence[tuple[str, tuple[Any, Any]]]]]
"""message -> constants and fields, as rosbags parses them"""
HEADER_BYTES = 4
SIZES = {
    "bool": "u1", "byte": "u1", "char": "u1", "uint8": "u1", "int8": "i1", "uint16": "u2", "int16": "i2",
    "uint32": "u4", "int32": "i4", "uint64": "u8", "int64": "i8", "float32": "f4", "float64": "f8",
}  # fmt: skip
BASE, NAME, ARRAY = 1, 2, 3
"""kinds of fields of rosbags; the fourth are sequences"""
ELEMENTS_MAX = 1 << 16
LAYOUTS_MAX = 64
"""of messages of one size: a text that changes with every message is none of a drive"""
BATCH = 4096


class NoSuchMessageError(Exception):
    """The bytes are no message of this definition."""


@dataclass
class _Walk:
    """One message walked through: where its numbers are, and the lengths that make its layout."""

    data: bytes
    definitions: Definitions
    at: int = HEADER_BYTES
    places: dict[str, tuple[int, str]] = field(default_factory=dict)
    """path of a number -> its first byte and numpy type"""
    lengths: list[int] = field(default_factory=list)
    """first bytes of lengths of texts and sequences"""

    def __post_init__(self) -> None:
        if len(self.data) < HEADER_BYTES or self.data[0] or self.data[1] not in (0, 1):
            raise NoSuchMessageError
        self.order = "<" if self.data[1] else ">"

    def message(self, kind: str, path: str) -> None:
        """All fields of a message."""
        if kind not in self.definitions:
            raise NoSuchMessageError
        for name, described in self.definitions[kind][1]:
            self._field(described, f"{path}.{name}" if path else name)

    def ends(self) -> bool:
        """Whether the message ends where its bytes do, but for zeros that fill up."""
        return self.at <= len(self.data) < self.at + 4 and not any(self.data[self.at :])

    def _field(self, described: tuple[Any, Any], path: str) -> None:
        kind, what = described
        if kind == BASE:
            self._number(what[0], path)
        elif kind == NAME:
            self.message(what, path)
        else:
            inner, count = what
            for i in range(count if kind == ARRAY else self._length()):
                self._field(inner, f"{path}[{i}]")

    def _number(self, name: str, path: str) -> None:
        if name in ("string", "wstring"):
            length = self._length()  # which moves `at` itself
            self.at += length * (2 if name == "wstring" else 1)
            return
        self.places[path] = self._take(SIZES[name]), self.order + SIZES[name]

    def _length(self) -> int:
        at = self._take("u4")
        self.lengths.append(at)
        count = int.from_bytes(self.data[at : at + 4], "little" if self.order == "<" else "big")
        if count > ELEMENTS_MAX:
            raise NoSuchMessageError
        return count

    def _take(self, numpy_type: str) -> int:
        """First byte of the next number; what is skipped to align it is zero."""
        size = int(numpy_type[1])
        at = self.at + (-(self.at - HEADER_BYTES)) % size
        if at + size > len(self.data) or any(self.data[self.at : at]):
            raise NoSuchMessageError
        self.at = at + size
        return at


def walk(data: bytes, kind: str, definitions: Definitions) -> _Walk:
    """One message.

    Raises:
        NoSuchMessageError: these bytes are none of this kind.
    """
    walked = _Walk(data, definitions)
    walked.message(kind, "")
    if not walked.ends():
        raise NoSuchMessageError
    return walked


@dataclass
class Columns:
    """Messages of one topic as columns, in their order."""

    kind: str
    definitions: Definitions
    unreadable: int = 0
    _waiting: list[bytes] = field(default_factory=list)
    _blocks: list[tuple[_Walk, NDArray[np.uint8], NDArray[np.int64]]] = field(default_factory=list)
    _count: int = 0

    def add(self, data: bytes) -> None:
        """One more message."""
        self._waiting.append(data)
        if len(self._waiting) == BATCH:
            self._settle()

    def __getitem__(self, path: str) -> Array:
        """(n,) numbers of one field, NaN where a message is not readable.

        Raises:
            KeyError: no such field.
        """
        return self.get(path, float).astype(np.float64)

    def get(self, path: str, kind: type) -> NDArray[Any]:
        """The same as whole numbers (`int`), zero where a message is not readable, or as floats."""
        self._settle()
        if not any(path in walked.places for walked, _, _ in self._blocks):
            raise KeyError(path)
        out: NDArray[Any] = np.zeros(self._count, np.int64) if kind is int else np.full(self._count, np.nan)
        for walked, block, rows in self._blocks:
            if path in walked.places:
                at, numpy_type = walked.places[path]
                size = np.dtype(numpy_type).itemsize
                out[rows] = np.ascontiguousarray(block[:, at : at + size]).view(numpy_type)[:, 0]
        return out

    def _settle(self) -> None:
        by_size: dict[int, list[int]] = {}
        for i, data in enumerate(self._waiting):
            by_size.setdefault(len(data), []).append(i)
        for size, indices in by_size.items():
            block = np.frombuffer(b"".join(self._waiting[i] for i in indices), np.uint8).reshape(-1, size)
            self._sort(block, self._count + np.array(indices))
        self._count += len(self._waiting)
        self._waiting = []

    def _sort(self, block: NDArray[np.uint8], rows: NDArray[np.int64]) -> None:
        """Messages of one size by their layouts."""
        for _ in range(LAYOUTS_MAX):
            if not len(rows):
                return
            try:
                walked = walk(block[0].tobytes(), self.kind, self.definitions)
            except NoSuchMessageError:
                same = np.arange(len(rows)) == 0
                self.unreadable += 1
            else:
                places = [HEADER_BYTES - 3, *(at + i for at in walked.lengths for i in range(4))]
                same = (block[:, places] == block[0, places]).all(axis=1)
                self._blocks.append((walked, block[same], rows[same]))
            block, rows = block[~same], rows[~same]
        self.unreadable += len(rows)
