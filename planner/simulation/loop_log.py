"""A drive of the loop as a drive log: the same columns a recorded session gives, without a file in between."""

from __future__ import annotations

import numpy as np

from estimator.drive_log.derived import BY_STATE_FILTER
from estimator.drive_log.table import DriveLog, segment_numbers
from hil_gateway.bus.messages import Estimate, Plan, VehicleState
from hil_gateway.bus.topics import ESTIMATE, PLAN, VEHICLE_STATE
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.process.errors import InputError
from hil_gateway.session.drive_table import FROM_ESTIMATE, FROM_STATE
from planner.simulation.loop import LoopResult

LOGGED = (VEHICLE_STATE, ESTIMATE, PLAN)
"""topics the loop has to keep: `Loop(config, keep=LOGGED)`"""
MOVING = 3.0
"""m/s; what comes before the car first moves is no drive"""


def drive_log(result: LoopResult) -> DriveLog:
    """Drive log of a loop that kept `LOGGED`: one row per valid estimate, from when the car first moves.

    Raises:
        InputError: the car never moved.
    """
    states = {m.stamp_ns: m for m in result.messages[VEHICLE_STATE.key] if isinstance(m, VehicleState)}
    plans = [m for m in result.messages[PLAN.key] if isinstance(m, Plan)]
    pairs = [
        (states[m.state_stamp_ns], m)
        for m in result.messages[ESTIMATE.key]
        if isinstance(m, Estimate) and m.valid and m.state_stamp_ns in states
    ]
    first = next((i for i, (_, estimate) in enumerate(pairs) if estimate.vx > MOVING), None)
    if first is None or not plans:
        raise InputError("the loop's car never moved: there is no drive to make a log of")
    rows = pairs[first:]
    stamps = np.array([state.stamp_ns for state, _ in rows], dtype=np.int64)
    columns = {"t": (stamps - stamps[0]) / NS_PER_S}
    columns |= {name: np.array([get(e) for _, e in rows], dtype=float) for name, get in FROM_ESTIMATE.items()}
    columns |= {name: np.array([get(v) for v, _ in rows], dtype=float) for name, get in FROM_STATE.items()}
    at = np.array([plan.state_stamp_ns for plan in plans], dtype=np.int64)
    index = np.maximum(np.searchsorted(at, stamps, side="right") - 1, 0)
    columns["lap"] = np.array([plan.lap for plan in plans], dtype=float)[index]
    segment, notes = segment_numbers(columns["t"]), ("driven by the loop",)
    return DriveLog(columns=columns, segment=segment, derived=BY_STATE_FILTER, notes=notes)
