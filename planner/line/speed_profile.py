"""Fastest speed along a given closed path within an envelope: forward-backward pass.

Cornering speed first, then what the engine can reach going forwards and what the brakes can shed going backwards, each
on the friction ellipse with grade and bank (Kapania, Subosits & Gerdes 2016). All in specific forces.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.process.arrays import Array
from planner.line.envelope import Envelope

Row = list[float]


def speed_profile(curvature: Array, grade: Array, bank: Array, length: float, envelope: Envelope) -> Array:
    """Speed, m/s, at equally spaced points of a closed path of `length` m; arrays (n,) of 1/m and rad."""
    ds = length / len(curvature)
    v = cornering_speed(curvature, bank, envelope)
    start = int(np.argmin(v))  # the slowest point is on its limit: one pass from there closes the lap
    rows = [np.roll(a, -start).tolist() for a in (v, curvature, GRAVITY * np.sin(grade), GRAVITY * np.sin(bank))]
    v2 = [u * u for u in rows[0]]
    v2.append(v2[0])
    for row in rows[1:]:
        row.append(row[0])
    path = (rows[1], rows[2], rows[3])
    _forwards(v2, path, 2.0 * ds, envelope)
    _backwards(v2, path, 2.0 * ds, envelope)
    return np.roll(np.sqrt(np.array(v2[:-1])), start)


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


# Both passes are sequential and run while the car drives, so their formulas stand in the loops: calls would double the
# time. used: share of the lateral limit; grip: specific force left on the friction ellipse.


def _forwards(v2: Row, path: tuple[Row, Row, Row], step: float, envelope: Envelope) -> None:
    """Limit v2, m2/s2, to what the engine reaches over each `step` of twice the distance, m; in place."""
    kappa, uphill, across = path
    (c0, c2), (l0, l2), (d0, d2) = envelope.lateral, envelope.longitudinal, envelope.drag
    traction, power = envelope.traction, envelope.power
    u = v2[0]
    for i in range(1, len(v2)):
        used = (u * kappa[i - 1] + across[i - 1]) / (c0 + c2 * u)
        left = 1.0 - used * used
        force = (l0 + l2 * u) * sqrt(left) if left > 0.0 else 0.0
        force = min(force, traction)
        if force * force * u > power * power:
            force = power / sqrt(u)
        u = u + step * (force - (d0 + d2 * u) - uphill[i - 1])
        u = v2[i] = min(v2[i], max(u, 1.0))


def _backwards(v2: Row, path: tuple[Row, Row, Row], step: float, envelope: Envelope) -> None:
    """Limit v2, m2/s2, to what the brakes shed over each `step` of twice the distance, m; in place."""
    kappa, uphill, across = path
    (c0, c2), (l0, l2), (d0, d2) = envelope.lateral, envelope.longitudinal, envelope.drag
    u = v2[-1]
    for i in range(len(v2) - 2, -1, -1):
        used = (u * kappa[i + 1] + across[i + 1]) / (c0 + c2 * u)
        left = 1.0 - used * used
        grip = (l0 + l2 * u) * sqrt(left) if left > 0.0 else 0.0
        loss = grip + (d0 + d2 * u) + uphill[i + 1]
        if loss > 0.0:
            u = u + step * loss
        if u > v2[i]:
            u = v2[i]
        else:
            v2[i] = u
