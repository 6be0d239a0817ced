"""Drive logs in CSV: fast when the file is right, and exact about file, row and column when it is not.

Rows are counted as a text editor counts lines: the header is row 1.
"""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hil_gateway.process.arrays import Array
from hil_gateway.process.errors import InputError
from hil_gateway.text_file import read_text

BYTES_MAX = 2_000_000_000
"""of a log: five hours at 1000 samples/s with ten columns"""
COLUMNS_MAX = 2000
"""more than any logger has channels"""
FROZEN_S = 2.0
"""A sensor that repeats one value exactly for so long while the car moves has stopped."""


def read_csv(
    path: Path, required: Sequence[str], watched: Sequence[str], min_rows: int
) -> tuple[dict[str, Array], list[str]]:
    """Columns of a drive log by name, and notes on rows left out.

    Raises:
        InputError: see `docs/identify.md`, "What is refused".
    """
    header, body, notes = _split(path)
    _check_header(path, header, required)
    table = _parse(path, header, body)
    lines = np.arange(2, len(table) + 2)
    _check_finite(path, header, table, lines)
    table, lines = _without_repeated_rows(header, table, lines, notes)
    if len(table) < min_rows:
        raise InputError(f"{path}: {len(table)} rows are too few: at least {min_rows} are needed")
    columns = {name: np.ascontiguousarray(table[:, i]) for i, name in enumerate(header)}
    _check_time(path, columns["t"], lines)
    _check_frozen(path, columns, lines, watched)
    return columns, notes


def _split(path: Path) -> tuple[list[str], list[str], list[str]]:
    """Header names, body lines and notes; empty lines at the end and one cut last row are left out, and said so."""
    text = read_text(path, BYTES_MAX, "drive log")
    lines = text.splitlines()
    if not lines or not lines[0].strip():
        raise InputError(f"{path}: row 1 is empty: the first row must name the columns")
    if (count := lines[0].count(",") + 1) > COLUMNS_MAX:
        raise InputError(f"{path}: row 1: {count} columns, a drive log has at most {COLUMNS_MAX}")
    header = [name.strip().strip('"') for name in lines[0].split(",")]
    body, notes = lines[1:], []
    while body and not body[-1].strip():
        body.pop()
    if body and not text.endswith("\n") and body[-1].count(",") < len(header) - 1:
        notes.append(f"row {len(body) + 1}, the last, is cut off and left out (1 row)")
        body.pop()
    return header, body, notes


def _check_header(path: Path, header: list[str], required: Sequence[str]) -> None:
    separator = next((c for c in ";\t" if len(header) == 1 and c in header[0]), None)
    if separator:
        raise InputError(f"{path}: row 1: values are separated by {separator!r}: write commas, with points in numbers")
    for name in required:
        if name not in header:
            raise InputError(f"{path}: row 1: column {name} is missing; found {', '.join(header)}")
    for i, name in enumerate(header):
        if not name:
            raise InputError(f"{path}: row 1: column {i + 1} has no name")
        if name in header[:i]:
            raise InputError(f"{path}: row 1: column {name} appears twice")


def _parse(path: Path, header: list[str], body: list[str]) -> Array:
    """(rows, columns) array; a file that numpy refuses is searched for the cell that is wrong."""
    if not body:
        raise InputError(f"{path}: no rows after the header")
    try:
        table = np.loadtxt(io.StringIO("\n".join(body)), delimiter=",", ndmin=2, comments=None)
    except ValueError:
        table = np.empty((0, 0))
    if table.shape != (len(body), len(header)):
        raise InputError(_first_bad_cell(path, header, body))
    return table


def _first_bad_cell(path: Path, header: list[str], body: list[str]) -> str:
    for row, line in enumerate(body, start=2):
        if not line.strip():
            return f"{path}: row {row} is empty"
        cells = line.split(",")
        for name, cell in zip(header, cells, strict=False):
            if not _is_number(cell):
                return f"{path}: row {row}, column {name}: {cell.strip()[:40]!r} is not a number"
        if len(cells) != len(header):
            return f"{path}: row {row}: {len(cells)} values for {len(header)} columns"
    return f"{path}: cannot be read as comma-separated numbers"


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _check_finite(path: Path, header: list[str], table: Array, lines: NDArray[np.int64]) -> None:
    if np.isfinite(table).all():
        _check_size(path, header, table, lines)
        return
    row, column = np.argwhere(~np.isfinite(table))[0]
    count = int((~np.isfinite(table)).sum())
    raise InputError(
        f"{path}: row {lines[row]}, column {header[column]}: {table[row, column]} is not finite"
        f" ({count} such value{'s' * (count > 1)}): repair or remove the row or the column"
    )


LARGEST = 1e12
"""of any column, whatever its unit: times in ns of a day have 1e14 and are refused as no seconds, nothing else of a car
comes near. Squares and sums of what passes stay finite"""


def _check_size(path: Path, header: list[str], table: Array, lines: NDArray[np.int64]) -> None:
    if np.abs(table).max(initial=0.0) <= LARGEST:
        return
    row, column = np.argwhere(np.abs(table) > LARGEST)[0]
    raise InputError(
        f"{path}: row {lines[row]}, column {header[column]}: {table[row, column]:g} is beyond {LARGEST:g}:"
        " no signal of a car; repair or remove the row or the column"
    )


def _without_repeated_rows(
    header: list[str], table: Array, lines: NDArray[np.int64], notes: list[str]
) -> tuple[Array, NDArray[np.int64]]:
    """Rows written twice carry nothing new and are left out; the same time with other values is an error later."""
    same_time = np.flatnonzero(np.diff(table[:, header.index("t")]) == 0.0) + 1
    repeated = [i for i in same_time if np.array_equal(table[i], table[i - 1])]
    if not repeated:
        return table, lines
    notes.append(f"{len(repeated)} rows written twice are left out, the first is row {lines[repeated[0]]}")
    keep = np.ones(len(table), bool)
    keep[repeated] = False
    return table[keep], lines[keep]


def _check_time(path: Path, t: Array, lines: NDArray[np.int64]) -> None:
    bad = np.flatnonzero(np.diff(t) <= 0.0)
    if bad.size:
        i = int(bad[0])
        raise InputError(
            f"{path}: row {lines[i + 1]}, column t: time does not increase: {t[i + 1]:.9g} s after {t[i]:.9g} s"
        )


def _check_frozen(path: Path, columns: dict[str, Array], lines: NDArray[np.int64], names: Sequence[str]) -> None:
    for name in names:
        if name in columns and (stretch := frozen_stretch(columns, name)):
            first, last = lines[stretch.start], lines[stretch.stop - 1]
            raise InputError(
                f"{path}: rows {first} to {last}, column {name}: frozen at {columns[name][stretch.start]:.6g}"
                f" for {columns['t'][stretch.stop - 1] - columns['t'][stretch.start]:.3g} s"
                " while the car moves: remove these rows, or the column if it can be derived"
            )


def frozen_stretch(columns: dict[str, Array], name: str) -> slice | None:
    """Longest stretch in which a channel has stopped, or None.

    Commands (steer, drive) may rest; they count as frozen if they never change, or if steer rests while the car
    turns both ways. Sensors count as frozen when they repeat one value exactly while the car moves.
    """
    values = columns[name]
    if values.size and values.min() == values.max():
        return slice(0, len(values))
    if name == "drive":
        return None
    stretch = _longest_run(values, columns["t"])
    if columns["t"][stretch.stop - 1] - columns["t"][stretch.start] < FROZEN_S:
        return None
    if name == "steer":
        return stretch if _turns_both_ways(columns["yaw_rate"], stretch) else None
    return stretch if _moves(columns, name, stretch) else None


def _longest_run(values: Array, t: Array) -> slice:
    edges = np.concatenate([[0], np.flatnonzero(np.diff(values)) + 1, [len(values)]])
    longest = int(np.argmax(t[edges[1:] - 1] - t[edges[:-1]]))
    return slice(int(edges[longest]), int(edges[longest + 1]))


def _turns_both_ways(yaw_rate: Array, rows: slice) -> bool:
    clearly = 0.3 * float(np.quantile(np.abs(yaw_rate), 0.95))
    return bool(yaw_rate[rows].max() > clearly and yaw_rate[rows].min() < -clearly)


def _moves(columns: dict[str, Array], name: str, rows: slice) -> bool:
    """Whether the other motion channels go on changing, as they do not at standstill."""
    others = [columns[n][rows] for n in ("vx", "vy", "yaw_rate") if n != name]
    speed = columns["vx"]
    moving = math.isclose(speed[rows].min(), 0.0, abs_tol=0.05 * float(np.quantile(np.abs(speed), 0.9)))
    changing = all(float(np.mean(np.diff(other) != 0.0)) > 0.5 for other in others)
    return changing and not moving
