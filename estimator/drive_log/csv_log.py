"""Drive logs as tables of numbers: columns in SI by their quantity, and exact about file, row and column when not."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from estimator.drive_log.column_map import ColumnMap, apply, proposed, without_delays
from estimator.drive_log.quantities import UNITS
from estimator.drive_log.tables import read_table
from hil_gateway.process.arrays import Array
from hil_gateway.process.errors import InputError

FROZEN_S = 2.0
"""A sensor that repeats one value exactly for so long while the car moves has stopped."""
SLOW_GAP_S = 1.1
"""Between samples of a channel that comes more slowly than the log, as positions of a receiver of 1 Hz do; over longer
times nothing is put in"""
STEPWISE = ("lap", "gear")
"""Numbers that hold until the next one"""
CLOCKS = {unit: UNITS["time"][unit] for unit in ("s", "ms", "us", "ns")}
RATES = (19.0, 1050.0)
"""samples/s of a drive log, with what clocks are off by"""


def read_csv(
    path: Path, required: Sequence[str], watched: Sequence[str], min_rows: int, mapping: ColumnMap | None = None
) -> tuple[dict[str, Array], list[str]]:
    """Columns of a drive log by name, and notes on conversions and on rows left out.

    Raises:
        InputError: see `docs/identify.md`, "What is refused".
    """
    written = read_table(path)
    mapping = mapping or proposed(written.names, written.units)
    columns, notes = apply(path, written.header, written.names, written.values, mapping)
    _check_names(path, written.header, written.names, columns, required)
    _in_seconds(columns, mapping, notes)
    columns = _filled(columns, {*required, "ax", "ay", "drive"}, notes)
    header = [*columns]
    table, lines = np.column_stack([*columns.values()]), written.lines
    _check_finite(path, header, table, lines)
    table, lines = _without_repeated_rows(header, table, lines, notes)
    columns = {name: np.ascontiguousarray(table[:, i]) for i, name in enumerate(header)}
    _check_time(path, columns["t"], lines)
    columns, lines = without_delays(columns, lines, mapping, notes)
    if len(lines) < min_rows:
        raise InputError(f"{path}: {len(lines)} rows are too few: at least {min_rows} are needed")
    _check_frozen(path, columns, lines, watched)
    return columns, [*written.notes, *notes]


def _check_names(
    path: Path, header: int, names: Sequence[str], columns: Mapping[str, Array], required: Sequence[str]
) -> None:
    for i, name in enumerate(names):
        if not name:
            raise InputError(f"{path}: row {header}: column {i + 1} has no name")
        if name in names[:i]:
            raise InputError(f"{path}: row {header}: column {name} appears twice")
    for name in required:
        if name not in columns:
            found = ", ".join(names)
            raise InputError(
                f"{path}: row {header}: column {name} is missing; found {found}; a map says which it is (--columns)"
            )


def _in_seconds(columns: dict[str, Array], mapping: ColumnMap, notes: list[str]) -> None:
    """Times from the first row on; where no unit is given, the one that makes a drive log of them."""
    t = columns["t"] - columns["t"][0]
    step = float(np.median(np.diff(t))) if len(t) > 1 else 0.0
    possible = [unit for unit, s in CLOCKS.items() if step > 0 and RATES[0] <= 1.0 / (step * s) <= RATES[1]]
    if not mapping.sources["t"].unit and possible and "s" not in possible:
        unit = possible[0]
        notes.append(f"t is in {unit}: steps of {step:g} are {1.0 / (step * CLOCKS[unit]):.4g} samples/s")
        t = CLOCKS[unit] * t
    columns["t"] = t if abs(columns["t"][0]) > LONG_AGO_S or possible != ["s"] else columns["t"]


LONG_AGO_S = 1e6
"""Times from a date on lose digits; shorter ones are kept as they are"""


def _filled(columns: dict[str, Array], complete: set[str], notes: list[str]) -> dict[str, Array]:
    """Channels that come more slowly than the log, put in between; those with too little in them are left out.

    `complete` must be there in every row: nothing is put into what tyres are found from.
    """
    out = {}
    for name, values in columns.items():
        there = np.isfinite(values) | np.isinf(values)
        if there.all() or name in complete:
            out[name] = values
            continue
        at = np.flatnonzero(there)
        gap = float(np.diff(columns["t"][at]).max()) if len(at) > 1 else math.inf
        if gap > SLOW_GAP_S and name not in STEPWISE:
            notes.append(f"column {name} is left out: {len(values) - len(at)} of {len(values)} rows have no value")
            continue
        out[name] = _between(name, columns["t"], values, at)
        notes.append(f"column {name} has values in {len(at)} of {len(values)} rows: put in between")
    return out


def _between(name: str, t: Array, values: Array, at: NDArray[np.int64]) -> Array:
    if not len(at):
        return np.zeros_like(values)
    if name in STEPWISE:
        held = np.maximum(np.searchsorted(at, np.arange(len(values)), side="right") - 1, 0)
        return np.asarray(values[at[held]])
    known = np.unwrap(values[at]) if name == "yaw" else values[at]
    return np.interp(t, t[at], known)


def _check_finite(path: Path, header: list[str], table: Array, lines: NDArray[np.int64]) -> None:
    if np.isfinite(table).all():
        _check_size(path, header, table, lines)
        return
    row, column = np.argwhere(~np.isfinite(table))[0]
    count = int((~np.isfinite(table)).sum())
    value = "empty or nan" if np.isnan(table[row, column]) else f"{table[row, column]}"
    raise InputError(
        f"{path}: row {lines[row]}, column {header[column]}: {value} is not finite"
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
