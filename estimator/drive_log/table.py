"""One table type for recorded drives, whatever file they come from: numpy columns, gaps, laps, notes."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from estimator.drive_log.column_map import ColumnMap
from estimator.drive_log.csv_log import RATES, read_csv
from estimator.drive_log.derived import BY_STATE_FILTER, add_missing_channels
from estimator.drive_log.tables import is_bag
from hil_gateway.process.arrays import Array
from hil_gateway.process.errors import InputError
from hil_gateway.process.writable import RECORDING
from hil_gateway.session.drive_table import VY_STD
from hil_gateway.session.logs.raw_bag import bag_files

REQUIRED = ("t", "vx", "vy", "yaw_rate", "steer")
"""What nothing else can stand in for."""

DERIVABLE = ("ax", "ay", "drive")
"""What is derived, and said so, where a log has it not."""

OPTIONAL = (
    "x", "y", "z", "yaw", "az", "lap", "throttle", "brake", "brake_balance", "gear", "engine_speed",
    "wheel_speed_fl", "wheel_speed_fr", "wheel_speed_rl", "wheel_speed_rr", VY_STD,
)  # fmt: skip

WATCHED = (*REQUIRED[1:], *DERIVABLE, "x", "y", "yaw", *(n for n in OPTIONAL if n.startswith("wheel_speed")))
"""Channels of a moving car that never rest, apart from commands: one that does has stopped."""

MIN_ROWS = 200
"""Shorter logs hold neither a held-out block nor a batch of 100 samples beside it."""

LEAST_SPEED = 0.1
"""m/s that a twentieth of a log exceeds: a model car at a tenth of its walking pace"""

GAP_STEPS = 4.0
"""A time step of more than so many median steps starts a new segment."""

FILE_GAP_S = 30.0
"""Time put between files read as one data set; longer than any window or filter memory."""


@dataclass(frozen=True)
class DriveLog:
    """One data set, SI units, ISO 8855 axes.

    Attributes:
        columns: name -> (n,) float array; always holds `REQUIRED` and `DERIVABLE`.
        segment: (n,) number of the uninterrupted stretch each row belongs to.
        derived: column -> how it was derived, for those the files did not hold.
        extra: names of unknown columns, carried along as candidate explanatory signals.
        notes: what a reader of the report must know about the data, in plain words.
        sources: path -> SHA-256 of each file.
    """

    columns: Mapping[str, Array]
    segment: NDArray[np.int64]
    derived: Mapping[str, str] = field(default_factory=dict)
    extra: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    sources: Mapping[str, str] = field(default_factory=dict)

    def __len__(self) -> int:
        return int(self.segment.size)

    def __getitem__(self, name: str) -> Array:
        return self.columns[name]

    def __contains__(self, name: str) -> bool:
        return name in self.columns

    @property
    def step(self) -> float:
        """Median time step, s."""
        return float(np.median(np.diff(self["t"])))

    def segments(self) -> list[slice]:
        """Uninterrupted stretches of rows, in order."""
        return runs(self.segment)

    def laps(self) -> list[tuple[int, slice]]:
        """(lap number, rows) of every stretch of one lap; empty where the log has no laps."""
        if "lap" not in self:
            return []
        return [(int(self["lap"][rows.start]), rows) for rows in runs(self["lap"])]

    def select(self, rows: NDArray[np.bool_]) -> DriveLog:
        """The rows where `rows` (n,) is true; a stretch that is cut becomes several segments."""
        breaks = np.diff(self.segment[rows]) != 0
        breaks |= np.diff(np.flatnonzero(rows)) > 1
        segment = np.concatenate([[0], np.cumsum(breaks)]).astype(np.int64)
        return replace(self, columns={n: c[rows] for n, c in self.columns.items()}, segment=segment)

    def with_columns(self, changes: Mapping[str, Array], note: str) -> DriveLog:
        """Columns replaced or added, with the reason."""
        return replace(self, columns={**self.columns, **changes}, notes=(*self.notes, note))


def runs(values: NDArray[np.generic]) -> list[slice]:
    """Stretches of equal neighbouring values."""
    edges = np.flatnonzero(values[1:] != values[:-1]) + 1
    bounds = [0, *edges.tolist(), len(values)]
    return [slice(a, b) for a, b in itertools.pairwise(bounds) if b > a]


def segment_numbers(t: Array) -> NDArray[np.int64]:
    """(n,) segment number of each row: a new one after every gap in `t`."""
    step = np.diff(t)
    return np.concatenate([[0], np.cumsum(step > GAP_STEPS * np.median(step))]).astype(np.int64)


def read_logs(paths: Sequence[Path | str], mapping: ColumnMap | None = None) -> DriveLog:
    """Read recorded drives (.csv, .mcap) as one data set; several files are joined with a gap between them.

    Raises:
        InputError: a file that cannot be read or used; the message names file, row and column.
    """
    if not paths:
        raise InputError("no drive log given: name at least one .csv or .mcap file")
    logs = [read_log(Path(path), mapping) for path in paths]
    return logs[0] if len(logs) == 1 else join(logs)


def read_log(path: Path, mapping: ColumnMap | None = None) -> DriveLog:
    """Read one file; see `read_logs`."""
    columns, notes = _read_columns(path, mapping)
    _check_rate(path, columns["t"])
    _check_driven(path, columns["vx"])
    segment = segment_numbers(columns["t"])
    columns, derived = add_missing_channels(path, columns, segment)
    derived |= BY_STATE_FILTER if VY_STD in columns else {}
    gaps = int(segment[-1])
    return DriveLog(
        columns=columns,
        segment=segment,
        derived=derived,
        extra=tuple(n for n in columns if n not in {*REQUIRED, *DERIVABLE, *OPTIONAL}),
        notes=(
            *(f"{path.name}: {note}" for note in notes),
            *(f"{path.name}: {name} is derived: {how}" for name, how in derived.items()),
            *((f"{path.name}: {gaps} gap{'s' * (gaps > 1)} in time",) if gaps else ()),
        ),
        sources={str(path): _digest(path)},
    )


def _read_columns(path: Path, mapping: ColumnMap | None) -> tuple[dict[str, Array], list[str]]:
    if _is_session(path):
        from estimator.drive_log.session_log import read_session

        columns, notes = read_session(path)
        return columns, notes
    return read_csv(path, REQUIRED, WATCHED, MIN_ROWS, mapping)


def _is_session(path: Path) -> bool:
    """Whether a file is a recording of this program, and no bag of another."""
    return path.suffix == RECORDING and not is_bag(path)


def _digest(path: Path) -> str:
    """SHA-256 of a file, of a bag's folder that of its files one after another."""
    digest = hashlib.sha256()
    for part in bag_files(path):
        with part.open("rb") as file:
            while data := file.read(1 << 20):
                digest.update(data)
    return digest.hexdigest()


def _check_rate(path: Path, t: Array) -> None:
    rate = 1.0 / float(np.median(np.diff(t)))
    if not RATES[0] <= rate <= RATES[1]:
        raise InputError(f"{path}: column t: {rate:.3g} samples/s is outside 20 to 1000 samples/s: is t in seconds?")


def _check_driven(path: Path, vx: Array) -> None:
    fast = float(np.quantile(vx, 0.95))
    if fast < LEAST_SPEED:
        raise InputError(
            f"{path}: column vx: at most {fast:.3g} m/s in 95 % of the rows, the car does not drive forward "
            f"(at least {LEAST_SPEED:g} m/s are needed): is vx in m/s and positive forward?"
        )


def join(logs: Iterable[DriveLog]) -> DriveLog:
    """One data set out of several: columns all of them have, time shifted to increase, laps renumbered.

    Raises:
        InputError: the sampling rates differ by more than a tenth.
    """
    logs = list(logs)
    _check_same_rate(logs)
    names = [n for n in logs[0].columns if all(n in log for log in logs)]
    parts = {n: [log[n] for log in logs] for n in names}
    parts["t"] = _in_sequence(parts["t"])
    if "lap" in parts:
        parts["lap"] = [lap + 1000.0 * i for i, lap in enumerate(parts["lap"])]
    starts = np.cumsum([0, *(int(log.segment[-1]) + 1 for log in logs)])
    lost = sorted({n for log in logs for n in log.columns} - set(names))
    note = (f"columns not in every file are left out: {', '.join(lost)}",) if lost else ()
    return DriveLog(
        columns={n: np.concatenate(p) for n, p in parts.items()},
        segment=np.concatenate([log.segment + s for log, s in zip(logs, starts, strict=False)]),
        derived={n: how for log in logs for n, how in log.derived.items()},
        extra=tuple(n for n in logs[0].extra if n in names),
        notes=tuple(note for log in logs for note in log.notes) + note,
        sources={path: digest for log in logs for path, digest in log.sources.items()},
    )


def _in_sequence(times: list[Array]) -> list[Array]:
    """Each file's time shifted to start a gap after the one before it, unless it already does."""
    shifted = [times[0]]
    for t in times[1:]:
        start = shifted[-1][-1] + FILE_GAP_S
        shifted.append(t + max(0.0, start - t[0]))
    return shifted


def _check_same_rate(logs: list[DriveLog]) -> None:
    first = logs[0].step
    for log in logs[1:]:
        if abs(log.step / first - 1.0) > 0.1:
            raise InputError(
                f"{next(iter(log.sources))}: time step {log.step:.4g} s differs from {first:.4g} s of "
                f"{next(iter(logs[0].sources))}: identify logs of different rates separately"
            )
