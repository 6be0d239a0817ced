"""A table of numbers as any logger writes it: separators, decimal commas, quotes, what stands above the names, units.

Rows are counted as a text editor counts lines.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np

from estimator.drive_log.quantities import is_unit
from hil_gateway.process.arrays import Array, Ints
from hil_gateway.process.errors import InputError
from hil_gateway.session.logs.source import DAMAGED, Source
from hil_gateway.text_file import text_of

BYTES_MAX = 2_000_000_000
"""of a log, unpacked: five hours at 1000 samples/s with ten columns"""
COLUMNS_MAX = 2000
"""more than any logger has channels"""
SEPARATORS = (",", ";", "\t", "|")
HEAD_LINES = 300
"""in which the names must stand"""
EMPTY = ("na", "n/a", "#n/a", "nan", "null", "none", "-", "--")
"""what loggers write where a channel has no sample"""
DAY_S = 86_400.0
_NUMBER = re.compile(r"[+-]?(?:\d+(?:[.,]\d*)?|[.,]\d+)(?:[eE][+-]?\d+)?|[+-]?inf(?:inity)?", re.IGNORECASE)
_BRACKETS = re.compile(r"(.*?)\s*(?:\[([^\]]*)\]|\(([^)]*)\))\s*")
_CLOCK = re.compile(r"(\d{1,2}):(\d{2}):(\d{2}(?:[.,]\d+)?)")


@dataclass(frozen=True)
class WrittenTable:
    """Columns of a log as written.

    Attributes:
        names: of the columns, without their units; units: as the header or the row below says, empty where it does not.
        values: (rows, columns), NaN where a cell is empty.
        lines: (rows,) line of the file; header: line of the names.
        notes: what was left out.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Array
    lines: Ints
    header: int
    notes: tuple[str, ...]


@dataclass(frozen=True)
class _Layout:
    """Where names, units and data are; `header`, `data` are indices of lines."""

    separator: str
    header: int
    data: int
    names: tuple[str, ...]
    units: tuple[str, ...]

    @property
    def first(self) -> int:
        """Line of the first row of data."""
        return self.data + 1


def read_text_table(path: Path) -> WrittenTable:
    """Read a log of numbers.

    Raises:
        InputError: unreadable, no names or no rows, a cell that is no number, a row with too few; with its place.
    """
    text = _text(path)
    lines = text.splitlines()
    layout = _find_layout(path, lines)
    body, notes = _body(lines, layout, ended=text.endswith("\n"))
    values = _numbers(body, layout)
    if values is None:
        values = np.array([*_rows(path, body, layout)])
    keep = _without_index(layout, values)
    if len(keep) < len(layout.names):
        notes.append("the first column has no name and counts the rows: left out")
    at = np.arange(layout.first, layout.first + len(body), dtype=np.int64)
    names, units = (tuple(texts[i] for i in keep) for texts in (layout.names, layout.units))
    return WrittenTable(names, units, values[:, keep], at, layout.header + 1, tuple(notes))


def _text(path: Path) -> str:
    try:
        with Source(path).open() as file:
            data = file.read(BYTES_MAX + 1)
    except DAMAGED as error:
        raise InputError(f"{path}: the packed file is cut off or damaged: {error}") from None
    if len(data) > BYTES_MAX:
        raise InputError(f"{path}: too large: a drive log has at most {BYTES_MAX} bytes")
    if b"\0" in data[:1000] and data[:2] not in (b"\xff\xfe", b"\xfe\xff"):
        raise InputError(f"{path}: not a text file; a drive log is a table of numbers with a row of names")
    return text_of(data)


def _find_layout(path: Path, lines: Sequence[str]) -> _Layout:
    """Names and data by the separator that gives most columns."""
    head = [(i, line) for i, line in enumerate(lines[:HEAD_LINES]) if line.strip()]
    if not head:
        raise InputError(f"{path}: row 1 is empty: the first row must name the columns")
    found = [layout for separator in SEPARATORS if (layout := _layout(head, separator)) is not None]
    if not found:
        separator = max(SEPARATORS, key=head[0][1].count)
        names = tuple(_cells(head[0][1], separator))
        if _is_data(names):
            raise InputError(f"{path}: row {head[0][0] + 1}: numbers: the row above the data must name the columns")
        return _Layout(separator, head[0][0], head[0][0] + 1, *_named(names, ()))
    layout = max(found, key=lambda one: len(one.names))
    if len(layout.names) > COLUMNS_MAX:
        raise InputError(
            f"{path}: row {layout.header + 1}: {len(layout.names)} columns, a drive log has at most {COLUMNS_MAX}"
        )
    return layout


def _layout(head: Sequence[tuple[int, str]], separator: str) -> _Layout | None:
    """The first row of mostly numbers that has names above it, as many as it has cells."""
    rows = [(i, _cells(line, separator)) for i, line in head]
    for k, (at, cells) in enumerate(rows):
        if len(cells) < 2 or not _is_data(cells):
            continue
        above = [(i, row) for i, row in rows[:k] if len(row) in (len(cells) - 1, len(cells)) and not _is_data(row)]
        units: Sequence[str] = ()
        if len(above) > 1 and all(is_unit(cell) for cell in above[-1][1]):
            units = above.pop()[1]  # the last of them may be empty, and then looks like a separator at the end
        names = [(i, row) for i, row in above if len(row) == len(cells)]
        if names:
            return _Layout(separator, names[-1][0], at, *_named(names[-1][1], units))
    return None


def _cells(line: str, separator: str) -> list[str]:
    cells = [cell.strip() for cell in next(csv.reader([line.lstrip("#% ")], delimiter=separator), [])]
    return cells[:-1] if len(cells) > 2 and not cells[-1] else cells  # a separator at the end of the row


def _is_data(cells: Sequence[str]) -> bool:
    """Whether more than half of the cells that hold something are numbers or times of day."""
    full = [cell for cell in cells if cell]
    return 2 * sum(bool(_NUMBER.fullmatch(c) or _CLOCK.search(c) or c.lower() in EMPTY) for c in full) > len(full)


def _named(names: Sequence[str], units: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names without units, and the units of the names or of the row below them."""
    found = [_BRACKETS.fullmatch(name) for name in names]
    inside = [(m[2] or m[3] or "") if m else "" for m in found]
    plain = [m[1] if m and is_unit(unit) else name for m, unit, name in zip(found, inside, names, strict=True)]
    below = [*units, *[""] * (len(names) - len(units))]
    named = [unit if m and is_unit(unit) else under for m, unit, under in zip(found, inside, below, strict=True)]
    return tuple(plain), tuple(named)


def _body(lines: Sequence[str], layout: _Layout, *, ended: bool) -> tuple[list[str], list[str]]:
    """Lines of the data; empty ones at the end and one cut last row are left out, and said so."""
    body, notes = list(lines[layout.data :]), list[str]()
    while body and not body[-1].strip():
        body.pop()
    if body and not ended and len(_cells(body[-1], layout.separator)) < len(layout.names):
        notes.append(f"row {layout.data + len(body)}, the last, is cut off and left out (1 row)")
        body.pop()
    return body, notes


def _numbers(body: Sequence[str], layout: _Layout) -> Array | None:
    """(rows, columns) by numpy, which is quick; None for a table it does not take."""
    text, separator = "\n".join(body).replace('"', ""), layout.separator
    if separator != ",":
        text = text.replace(",", ".")
    if body and body[0].rstrip().endswith(separator):
        text = re.sub(rf"{re.escape(separator)}[ ]*$", "", text, flags=re.MULTILINE)
    values = _loaded(text, separator)
    if values is None:
        values = _loaded(_with_nan(text, separator), separator)
    return values if values is not None and values.shape == (len(body), len(layout.names)) else None


def _loaded(text: str, separator: str) -> Array | None:
    try:
        return np.asarray(np.loadtxt(io.StringIO(text), delimiter=separator, ndmin=2, comments=None), np.float64)
    except ValueError:
        return None


def _with_nan(text: str, separator: str) -> str:
    """The same with `nan` in cells that hold nothing, or a word for it."""
    edge = f"[{re.escape(separator)}\n]"
    words = "|".join(map(re.escape, EMPTY))
    empty = re.compile(rf"(?<={edge})[ ]*(?:{words})?[ ]*(?={edge})", re.IGNORECASE)
    return empty.sub("nan", f"\n{text}\n")[1:-1]


def _rows(path: Path, body: Sequence[str], layout: _Layout) -> Iterator[list[float]]:
    """Row by row, with times of day and dates in the first column that has them.

    Raises:
        InputError: the first cell or row that is none.
    """
    if not body:
        raise InputError(f"{path}: no rows after the names in row {layout.header + 1}")
    last, days = 0.0, 0.0
    for row, line in enumerate(body, start=layout.first):
        if not line.strip():
            raise InputError(f"{path}: row {row} is empty")
        cells, values = _cells(line, layout.separator), list[float]()
        cells += [""] * (len(layout.names) - len(cells) if line.count(layout.separator) >= len(layout.names) - 1 else 0)
        for name, cell in zip(layout.names, cells, strict=False):
            value = _value(cell)
            if value is None:
                raise InputError(f"{path}: row {row}, column {name}: {cell[:40]!r} is not a number")
            if _CLOCK.search(cell):
                days += DAY_S if value + days < last - DAY_S / 2 else 0.0
                value = last = value + days
            values.append(value)
        if len(cells) != len(layout.names):
            raise InputError(f"{path}: row {row}: {len(cells)} values for {len(layout.names)} columns")
        yield values


def _value(cell: str) -> float | None:
    """A number, NaN for an empty cell, seconds for a time of day or a date; None for anything else."""
    if not cell or cell.lower() in EMPTY:
        return float("nan")
    if _NUMBER.fullmatch(cell):
        return float(cell.replace(",", "."))
    try:
        return datetime.fromisoformat(cell.replace("Z", "+00:00")).timestamp()
    except ValueError:
        return seconds_of_day(cell)


def seconds_of_day(cell: str) -> float | None:
    """Of HH:MM:SS with either decimal mark; None for anything else."""
    clock = _CLOCK.fullmatch(cell)
    return None if clock is None else 3600.0 * int(clock[1]) + 60.0 * int(clock[2]) + float(clock[3].replace(",", "."))


def _without_index(layout: _Layout, values: Array) -> list[int]:
    """Columns to keep: all but a first one without a name that counts the rows, as data frames are written."""
    counted = np.array_equal(values[:, 0], values[0, 0] + np.arange(len(values)))
    unnamed = layout.names[0].lower() in ("", "unnamed: 0", "index")
    return [*range(1 if unnamed and counted else 0, len(layout.names))]
