"""Session -> drive-log columns (docs/formats.md): the one place where topics are mapped onto them.

Only what the car reports and what the estimator makes of it is used, never the plant's truth. One row per valid
estimate, joined with the vehicle state it answers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil_gateway.bus.messages import ESTIMATED, Estimate, VehicleState
from hil_gateway.bus.topics import ESTIMATE, PLAN, VEHICLE_STATE
from hil_gateway.car.actuation import brake_balance
from hil_gateway.car.states import under_yellow
from hil_gateway.process.arrays import Array
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.process.errors import InputError
from hil_gateway.session.files.format import named, unpack_message
from hil_gateway.session.files.reader import Item, SessionReader

VY = ESTIMATED.index("vy")
FROM_ESTIMATE: Mapping[str, Callable[[Estimate], float]] = {
    "vx": lambda e: e.vx,
    "vy": lambda e: e.vy,
    "yaw_rate": lambda e: e.yaw_rate,
    "x": lambda e: e.x,
    "y": lambda e: e.y,
    "yaw": lambda e: e.yaw,
}
VY_STD = "vy_std"
"""column with the deviation of a `vy` that a filter has estimated, m/s: where it is, no sensor has measured `vy`"""
FROM_STATE: Mapping[str, Callable[[VehicleState], float]] = {
    "ax": lambda v: v.ax,
    "ay": lambda v: v.ay,
    "az": lambda v: v.az,
    "steer": lambda v: v.steer,
    "drive": lambda v: v.drive,
    "throttle": lambda v: v.throttle,
    "brake": lambda v: (v.brake_front + v.brake_rear) / 2,
    "brake_balance": lambda v: brake_balance(v.brake_front, v.brake_rear),
    "wheel_speed_fl": lambda v: v.wheel_speed_fl,
    "wheel_speed_fr": lambda v: v.wheel_speed_fr,
    "wheel_speed_rl": lambda v: v.wheel_speed_rl,
    "wheel_speed_rr": lambda v: v.wheel_speed_rr,
    "gear": lambda v: v.gear,
    "engine_speed": lambda v: v.engine_speed,
}


@dataclass(frozen=True)
class DriveTable:
    """Columns of equal length, SI; `left_out` counts the rows that could not be used, by reason."""

    columns: dict[str, Array]
    start_ns: int
    """stamp of the first row, gateway clock: row times are `t` after it"""
    left_out: dict[str, int]
    damage: tuple[str, ...]
    yellow: NDArray[np.bool_]
    """rows under a yellow flag"""


def read_drive_table(path: Path, *following: Path, placed: bool = False) -> DriveTable:
    """Drive-log columns of one recorded session, and of the files that go on with it.

    `placed`: also the rows of estimates of which no more than place and speed hold.

    Raises:
        InputError: no recording, or one without estimates.
    """
    topics = frozenset({VEHICLE_STATE.key, ESTIMATE.key, PLAN.key})
    readers = [SessionReader(file, topics) for file in (path, *following)]
    with named(path):
        rows, left_out, laps = _collect(chain.from_iterable(reader.items() for reader in readers), placed)
    if not rows:
        raise InputError(f"{path}: holds no valid {ESTIMATE} with its {VEHICLE_STATE}: nothing to make a drive log of")
    stamps = np.array([state.stamp_ns for state, _ in rows], dtype=np.int64)
    columns = {"t": (stamps - stamps[0]) / NS_PER_S}
    columns |= {name: np.array([get(e) for _, e in rows], dtype=float) for name, get in FROM_ESTIMATE.items()}
    columns[VY_STD] = np.array([e.std[VY] for _, e in rows], dtype=float)
    columns |= {name: np.array([get(v) for v, _ in rows], dtype=float) for name, get in FROM_STATE.items()}
    if laps:
        columns["lap"] = _lap_at(stamps, laps)
    yellow = np.array([under_yellow(v.track_flag, v.vehicle_flag) for v, _ in rows], dtype=bool)
    damage = tuple(str(place) for reader in readers for place in reader.damage)
    return DriveTable(columns, int(stamps[0]), left_out, damage, yellow)


def _collect(
    items: Iterable[Item], placed: bool
) -> tuple[list[tuple[VehicleState, Estimate]], dict[str, int], list[tuple[int, int]]]:
    states: dict[int, VehicleState] = {}
    estimates: dict[int, Estimate] = {}
    laps: list[tuple[int, int]] = []
    for item in items:
        if item.topic == VEHICLE_STATE.key:
            state = unpack_message(VEHICLE_STATE, item.data)
            states[state.stamp_ns] = state
        elif item.topic == ESTIMATE.key:
            estimate = unpack_message(ESTIMATE, item.data)
            estimates[estimate.state_stamp_ns] = estimate
        elif item.topic == PLAN.key:
            plan = unpack_message(PLAN, item.data)
            laps.append((plan.state_stamp_ns, plan.lap))
    valid = {stamp: e for stamp, e in estimates.items() if e.valid or (placed and e.placed)}
    rows = [(states[stamp], valid[stamp]) for stamp in sorted(valid) if stamp in states]
    left_out = {"estimate not valid": len(estimates) - len(valid), "vehicle state missing": len(valid) - len(rows)}
    return rows, {reason: count for reason, count in left_out.items() if count}, sorted(laps)


def _lap_at(stamps: NDArray[np.int64], laps: list[tuple[int, int]]) -> Array:
    """Lap number at each stamp: the newest plan's, or the first one's before it."""
    at, number = np.array(laps, dtype=np.int64).T
    index = np.searchsorted(at, stamps, side="right") - 1
    return np.asarray(number[np.maximum(index, 0)], dtype=float)


def as_rows(columns: Mapping[str, Array]) -> Iterable[tuple[Any, ...]]:
    """The table row by row."""
    return zip(*columns.values(), strict=True)
