"""Fastest speed along a given closed path within an envelope: forward-backward pass.

Cornering speed first, then what the engine can reach going forwards and what the brakes can shed going backwards, each
on the friction ellipse with grade and bank (Kapania, Subosits & Gerdes 2016). All in specific forces.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from threading import Lock
from typing import Any

import casadi as ca
import numpy as np

from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.process.arrays import Array
from hil_gateway.process.compiled import CompiledFunction, compile_function
from planner.line.envelope import Envelope


def speed_profile(curvature: Array, grade: Array, bank: Array, length: float, envelope: Envelope) -> Array:
    """Speed, m/s, at equally spaced points of a closed path of `length` m; arrays (n,) of 1/m and rad."""
    ds = length / len(curvature)
    v = cornering_speed(curvature, bank, envelope)
    start = int(np.argmin(v))  # the slowest point is on its limit: one pass from there closes the lap
    rows = [np.roll(a, -start) for a in (v, curvature, GRAVITY * np.sin(grade), GRAVITY * np.sin(bank))]
    # point 0 once more at the end: each pass goes once round
    limit, *path = (np.append(row, row[0]) for row in rows)
    v2 = limit**2
    before, after = (np.array([row[:-1] for row in path]), np.array([row[:0:-1] for row in path]))
    v2[1:] = _run(_forwards, v2[0], np.vstack([v2[1:], before]), 2.0 * ds, envelope)
    v2[-2::-1] = _run(_backwards, v2[-1], np.vstack([v2[-2::-1], after]), 2.0 * ds, envelope)
    return np.asarray(np.roll(np.sqrt(v2[:-1]), start))


def cornering_speed(curvature: Array, bank: Array, envelope: Envelope) -> Array:
    """Largest v with |v^2 kappa + g sin(bank)| <= lateral limit(v), m/s, shape (n,)."""
    c0, c2 = envelope.lateral
    helping = -np.sign(curvature) * GRAVITY * np.sin(bank)
    slope = np.abs(curvature) - c2
    v2 = np.where(slope > 1e-9, (c0 + helping) / np.maximum(slope, 1e-9), np.inf)
    return np.asarray(np.sqrt(np.clip(v2, 1.0, envelope.max_speed**2)))


def lap_time_of(v: Array, length: float) -> float:
    """Lap time, s, of speeds at equal steps of a closed path (trapezoid in the slowness)."""
    return float(np.sum(2.0 / (v + np.roll(v, -1))) * length / len(v))


def _forwards() -> ca.Function:
    """Speed squared at a point from the one before, limited to what the engine reaches."""
    u, limit, kappa, uphill, across, doubled, p = _symbols()
    left = 1.0 - ((u * kappa + across) / (p["lateral0"] + p["lateral2"] * u)) ** 2
    grip = (p["longitudinal0"] + p["longitudinal2"] * u) * ca.sqrt(ca.fmax(left, 0.0))
    force = ca.fmin(ca.fmin(grip, p["traction"]), p["power"] / ca.sqrt(u))
    reached = u + doubled * (force - (p["drag0"] + p["drag2"] * u) - uphill)
    return _point("forwards", ca.fmin(limit, ca.fmax(reached, 1.0)), (u, limit, kappa, uphill, across, doubled, p))


def _backwards() -> ca.Function:
    """Speed squared at a point from the one after, limited to what the brakes shed."""
    u, limit, kappa, uphill, across, doubled, p = _symbols()
    left = 1.0 - ((u * kappa + across) / (p["lateral0"] + p["lateral2"] * u)) ** 2
    grip = (p["longitudinal0"] + p["longitudinal2"] * u) * ca.sqrt(ca.fmax(left, 0.0))
    loss = grip + (p["drag0"] + p["drag2"] * u) + uphill
    reached = u + doubled * ca.fmax(loss, 0.0)
    return _point("backwards", ca.fmin(limit, reached), (u, limit, kappa, uphill, across, doubled, p))


ENVELOPE = ("lateral0", "lateral2", "longitudinal0", "longitudinal2", "drag0", "drag2", "traction", "power")
"""what a pass needs of an envelope, in the order of `_numbers`"""


def _numbers(envelope: Envelope) -> Array:
    e = envelope
    return np.array([*e.lateral, *e.longitudinal, *e.drag, e.traction, e.power])


def _symbols() -> tuple[Any, ...]:
    """Speed squared at the neighbour, limit here; curvature, gravity along and across there; twice the distance."""
    numbers = ca.SX.sym("envelope", len(ENVELOPE))
    names = ("u", "limit", "kappa", "uphill", "across", "doubled")
    return (*(ca.SX.sym(name) for name in names), dict(zip(ENVELOPE, ca.vertsplit(numbers), strict=True)))


def _point(name: str, value: Any, symbols: tuple[Any, ...]) -> ca.Function:
    u, limit, kappa, uphill, across, doubled, p = symbols
    return ca.Function(name, [u, ca.vertcat(limit, kappa, uphill, across), doubled, ca.vertcat(*p.values())], [value])


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
