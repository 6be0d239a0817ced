"""One lap of a session over distance: what two laps are compared by."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from can_dbc.units import UNITS
from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.process.arrays import Array
from hil_gateway.process.errors import InputError
from hil_gateway.process.figures import lap_time
from hil_gateway.session.drive_table import DriveTable, read_drive_table
from hil_gateway.session.run import run_of
from hil_gateway.track.lap_clock import Lap, LapClock
from hil_gateway.track.track import Track

STATION_M = 2.0
CHANNELS = ("speed", "steer", "accelerator", "brake", "ax", "ay")
"""km/h, deg at the road wheel, 0..100 %, bar, g, g"""


@dataclass(frozen=True)
class LapTable:
    """Columns over `s` (m along the centre line, every `STATION_M`), all of one length; `t` in s since the line."""

    session: str
    lap: Lap
    s: Array
    t: Array
    x: Array
    y: Array
    channels: dict[str, Array]


def read_lap(path: Path, track: Track, number: int | None = None) -> LapTable:
    """A lap of a run that begins with the recording `path`, by default its best one.

    Raises:
        InputError: unreadable recording, no complete lap, no such lap.
    """
    table = read_drive_table(*run_of(path), placed=True)
    columns = table.columns
    along, clock = _along(table, track)
    if not clock.laps:
        raise InputError(f"{path}: holds no complete lap of {track.name}; give the right --track, or drive a whole lap")
    if number is not None and not 1 <= number <= len(clock.laps):
        raise InputError(f"{path}: no lap {number}; it holds the laps 1 to {len(clock.laps)}")
    best = clock.best or min(clock.laps, key=lambda lap: lap.time_s)
    lap = best if number is None else clock.laps[number - 1]
    return _resampled(path.stem if path.stem != "session" else path.parent.name, lap, columns, along, track)


def _along(table: DriveTable, track: Track) -> tuple[Array, LapClock]:
    """Arc length at every row, NaN where the car is not near the track, and the laps."""
    clock, s, hint = LapClock(track.length), np.full(len(table.yellow), np.nan), None
    rows = zip(*(table.columns[n].tolist() for n in ("t", "x", "y", "vx")), table.yellow.tolist(), strict=True)
    for i, (t, x, y, vx, yellow) in enumerate(rows):
        if track.near(x, y):
            hint, _ = track.project(x, y, hint)
            s[i] = hint
            clock.update(t, hint, vx, yellow)
    return s, clock


def _resampled(name: str, lap: Lap, columns: dict[str, Array], along: Array, track: Track) -> LapTable:
    """Rows of the lap at equal stations; where the car went backwards the first passage counts."""
    t = columns["t"]
    rows = (t >= lap.start_s) & (t < lap.start_s + lap.time_s) & np.isfinite(along)
    inside = along[rows]
    forward = inside > np.concatenate([[-np.inf], np.maximum.accumulate(inside)[:-1]])
    # the line itself may lie between two rows: the last of the lap before reads as its first
    forward &= ~((np.arange(len(inside)) < len(inside) // 2) & (inside > 0.9 * track.length))
    known = inside[forward]
    stations = np.arange(0.0, track.length, STATION_M)

    def over(values: Array) -> Array:
        return np.asarray(np.interp(stations, known, values[rows][forward]))

    steer = np.degrees(columns["steer"])
    values = {
        "speed": columns["vx"] / UNITS["km/h"].factor, "steer": steer, "accelerator": 100.0 * columns["throttle"],
        "brake": columns["brake"] / UNITS["bar"].factor, "ax": columns["ax"] / GRAVITY, "ay": columns["ay"] / GRAVITY,
    }  # fmt: skip
    channels = {channel: over(values[channel]) for channel in CHANNELS}
    return LapTable(name, lap, stations, over(t - lap.start_s), over(columns["x"]), over(columns["y"]), channels)


def title(table: LapTable) -> str:
    """`session, lap 3: 54.12 s`, and what marks it."""
    marks = f" ({', '.join(table.lap.marks)})" if table.lap.marks else ""
    return f"{table.session}, lap {table.lap.number}: {lap_time(table.lap.time_s)}{marks}"
