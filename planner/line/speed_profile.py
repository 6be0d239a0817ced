"""Fastest speed along a given closed path within an envelope: forward-backward pass.

Cornering speed first, then what the engine can reach going forwards and what the brakes can shed going backwards, each
within what cornering leaves, with grade, bank and vertical curve (Kapania, Subosits & Gerdes 2016). All in specific
forces.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from threading import Lock
from typing import Any

import casadi as ca
import numpy as np

from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.process.arrays import Array
from hil_gateway.process.compiled import CompiledFunction, compile_function
from planner.line.envelope import MIN_NORMAL, Envelope, normal_share
from planner.line.longitudinal_reserve import SHARES, SPEEDS, interpolated


@dataclass(frozen=True)
class RoadPath:
    """A closed path of `length` m at equal steps, arrays (n,): curvature 1/m, grade, bank rad, bend of the road rad/m,
    share of the envelope that may be used."""

    curvature: Array
    grade: Array
    bank: Array
    bend: Array
    length: float
    trust: Array | float = 1.0


def speed_profile(path: RoadPath, envelope: Envelope) -> Array:
    """Speed, m/s, at the points of the path, shape (n,)."""
    ds = path.length / len(path.curvature)
    v = cornering_speed(path, envelope)
    start = int(np.argmin(v))  # the slowest point is on its limit: one pass from there closes the lap
    level, dip = normal_share(path.grade, path.bank, path.bend, path.curvature)
    along, across = GRAVITY * np.sin(path.grade), GRAVITY * np.sin(path.bank)
    columns = (v, path.curvature, along, across, level, dip, np.broadcast_to(path.trust, v.shape))
    rows = [np.roll(a, -start) for a in columns]
    # point 0 once more at the end: each pass goes once round
    limit, *road = (np.append(row, row[0]) for row in rows)
    v2 = limit**2
    before, after = (np.array([row[:-1] for row in road]), np.array([row[:0:-1] for row in road]))
    v2[1:] = _run(_forwards, v2[0], np.vstack([v2[1:], before]), 2.0 * ds, envelope)
    v2[-2::-1] = _run(_backwards, v2[-1], np.vstack([v2[-2::-1], after]), 2.0 * ds, envelope)
    return np.asarray(np.roll(np.sqrt(v2[:-1]), start))


def cornering_speed(path: RoadPath, envelope: Envelope) -> Array:
    """Largest v with |v^2 kappa + g sin(bank)| <= lateral limit(v), m/s, shape (n,)."""
    a, b = normal_share(path.grade, path.bank, path.bend, path.curvature)
    c0, c2 = (path.trust * c for c in envelope.lateral)
    helping = -np.sign(path.curvature) * GRAVITY * np.sin(path.bank)
    slope = np.abs(path.curvature) - c2 - c0 * b
    v2 = np.where(slope > 1e-9, (c0 * a + helping) / np.maximum(slope, 1e-9), np.inf)
    return np.asarray(np.sqrt(np.clip(v2, 1.0, envelope.max_speed**2)))


def lap_time_of(v: Array, length: float) -> float:
    """Lap time, s, of speeds at equal steps of a closed path (trapezoid in the slowness)."""
    return float(np.sum(2.0 / (v + np.roll(v, -1))) * length / len(v))


def _forwards() -> ca.Function:
    """Speed squared at a point from the one before, limited to what the engine reaches."""
    step = _symbols()
    force = ca.fmin(ca.fmin(_grip(step, "drive"), step["traction"]), step["power"] / ca.sqrt(step["u"]))
    reached = step["u"] + step["doubled"] * (force - _drag(step) - step["uphill"])
    return _point("forwards", ca.fmin(step["limit"], ca.fmax(reached, 1.0)), step)


def _backwards() -> ca.Function:
    """Speed squared at a point from the one after, limited to what the brakes shed."""
    step = _symbols()
    loss = _grip(step, "brake") + _drag(step) + step["uphill"]
    return _point("backwards", ca.fmin(step["limit"], step["u"] + step["doubled"] * ca.fmax(loss, 0.0)), step)


def _grip(step: Mapping[str, Any], way: str) -> Any:
    """Specific force that cornering leaves, m/s2."""
    u, trust = step["u"], step["trust"]
    normal = ca.fmax(step["level"] + step["dip"] * u, MIN_NORMAL)
    used = (u * step["kappa"] + step["across"]) / (trust * (normal * step["lateral0"] + step["lateral2"] * u))
    left = interpolated(step[f"{way}_left"], ca.sqrt(u), ca.fabs(used))
    return trust * (normal * step[f"{way}0"] + step[f"{way}2"] * u) * left


def _drag(step: Mapping[str, Any]) -> Any:
    return step["drag0"] + step["drag2"] * step["u"]


ENVELOPE = (
    "lateral0", "lateral2", "brake0", "brake2", "drive0", "drive2", "drag0", "drag2", "traction", "power",
)  # fmt: skip
"""what a pass needs of an envelope, in the order of `_numbers`"""
LEFT = ("brake_left", "drive_left")
"""its tables, flat, after them"""
ROAD = ("limit", "kappa", "uphill", "across", "level", "dip", "trust")
"""limit of speed squared here, and of the neighbour: curvature, gravity along and across, axle load over the weight as
level + dip v^2, share of the envelope that may be used"""


def _numbers(envelope: Envelope) -> Array:
    e = envelope
    numbers = [*e.lateral, *e.brake, *e.drive, *e.drag, e.traction, e.power]
    return np.concatenate([numbers, np.ravel(e.brake_left), np.ravel(e.drive_left)])


def _symbols() -> dict[str, Any]:
    """Speed squared `u` at the neighbour, twice the distance, `ROAD`, `ENVELOPE` and `LEFT`."""
    numbers = {name: ca.SX.sym(name) for name in ("u", "doubled", *ROAD, *ENVELOPE)}
    return numbers | {name: ca.SX.sym(name, len(SPEEDS) * len(SHARES)) for name in LEFT}


def _point(name: str, value: Any, step: Mapping[str, Any]) -> ca.Function:
    road, envelope = (ca.vertcat(*(step[n] for n in names)) for names in (ROAD, (*ENVELOPE, *LEFT)))
    return ca.Function(name, [step["u"], road, step["doubled"], envelope], [value])


@cache
def _pass(step: Callable[[], ca.Function], points: int) -> tuple[CompiledFunction, Lock]:
    """One sequential pass over so many points: compiled, tens of us, so that it may run while the car drives."""
    one: Any = step()
    return compile_function(one.mapaccum(f"{one.name()}_{points}", points)), Lock()


def _run(step: Callable[[], ca.Function], start: float, rows: Array, doubled: float, envelope: Envelope) -> Array:
    function, lock = _pass(step, rows.shape[1])
    with lock:
        for target, value in zip(function.inputs, (start, rows, doubled, _numbers(envelope)), strict=True):
            target[:] = np.asarray(value).reshape(target.shape[0], -1)
        function()
        return np.array(function.outputs[0][0])
