"""The bytes and lines of a log, unpacked where it is compressed and decoded whatever its encoding."""

from __future__ import annotations

import bz2
import codecs
import gzip
import io
import lzma
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, BinaryIO

import lz4.frame  # type: ignore[import-untyped]
import zstandard

from hil_gateway.process.errors import InputError
from hil_gateway.text_file import check_ends, text_of

HEAD_BYTES, HEAD_PIECE = 1 << 16, 1 << 10
"""of a file that its reader is chosen by, read in such pieces: a packed file that is cut off fails in its last one"""
LINE_BYTES_MAX = 1 << 16
"""of a line of a log: longer ones are no text"""


def _open_zstd(path: Path) -> BinaryIO:
    """Buffered, since its own reader knows no lines; frames may follow each other."""
    reader = zstandard.ZstdDecompressor().stream_reader(path.open("rb"), read_across_frames=True, closefd=True)
    return io.BufferedReader(reader)


UNPACKERS: dict[bytes, Callable[[Any], Any]] = {
    b"\x1f\x8b": gzip.open,
    b"BZh": bz2.open,
    b"\xfd7zXZ\x00": lzma.open,
    b"\x28\xb5\x2f\xfd": _open_zstd,
    b"\x04\x22\x4d\x18": lz4.frame.open,
}
"""first bytes -> what opens the file"""
DAMAGED = (EOFError, zlib.error, lzma.LZMAError, zstandard.ZstdError, RuntimeError, gzip.BadGzipFile)
"""what unpackers raise for a file that is cut off or damaged"""


@dataclass(frozen=True)
class Line:
    """One line of text, counted from 1; `ended` is false for a last line without its end."""

    number: int
    text: str
    ended: bool


@dataclass
class Source:
    """One file to be recognised and read.

    Raises:
        InputError: no such file, not one that ends, or not readable.
    """

    path: Path
    cut: bool = field(default=False, init=False)
    """whether the packed file ended before its end"""

    notes: list[str] = field(default_factory=list, init=False)
    """what its reader has to say of the file"""

    def __post_init__(self) -> None:
        check_ends(self.path, "log")

    @cached_property
    def head(self) -> bytes:
        """The first bytes, unpacked; of a packed file that is cut off, what is there."""
        head = bytearray()
        with self.open() as file:
            try:
                while len(head) < HEAD_BYTES and (piece := file.read(min(HEAD_PIECE, HEAD_BYTES - len(head)))):
                    head += piece
            except DAMAGED:
                self.cut = True
        return bytes(head)

    @property
    def packed(self) -> bool:
        """Whether the file is compressed as a whole."""
        return self._unpacker is not None

    @cached_property
    def first_lines(self) -> list[str]:
        """Lines of the head, without the last, which may be cut; all of a file that is no longer."""
        lines = text_of(self.head).splitlines()
        return lines[:-1] if len(self.head) == HEAD_BYTES else lines

    @cached_property
    def _unpacker(self) -> Callable[[Any], Any] | None:
        with _readable(self.path), self.path.open("rb") as file:
            start = file.read(8)
        return next((unpack for magic, unpack in UNPACKERS.items() if start.startswith(magic)), None)

    @contextmanager
    def open(self) -> Iterator[BinaryIO]:
        """The content, unpacked."""
        with _readable(self.path):
            file = self._unpacker(self.path) if self._unpacker else self.path.open("rb")
        with _readable(self.path), file:
            yield file

    def lines(self) -> Iterator[Line]:
        """Every line; a packed file that is cut off ends early, and `cut` says so."""
        with self.open() as file:
            wide = self.head[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
            stream: Any = codecs.getreader("utf-16")(file, "replace") if wide else file
            number = 0
            try:
                while raw := stream.readline(LINE_BYTES_MAX):
                    number += 1
                    text = raw if isinstance(raw, str) else text_of(raw)
                    yield Line(number, text.rstrip("\r\n"), text.endswith("\n"))
            except DAMAGED:
                self.cut = True


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        if isinstance(error, DAMAGED):
            raise
        raise InputError(f"{path}: cannot read: {error.strerror or error}") from None
