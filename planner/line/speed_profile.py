"""Fastest speed along a given closed path within an envelope: forward-backward pass.

Cornering speed first, then what the engine can reach going forwards and what the brakes can shed going backwards, each
on the friction ellipse with grade, bank and vertical curve (Kapania, Subosits & Gerdes 2016). All in specific forces.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np

from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.process.arrays import Array
from planner.line.envelope import MIN_NORMAL, Envelope, normal_share

Row = list[float]


@dataclass(frozen=True)
class Path:
    """A closed path of `length` m at equal steps, arrays (n,): curvature 1/m, grade, bank rad, bend of the road rad/m,
    share of the envelope that may be used."""

    curvature: Array
    grade: Array
    bank: Array
    bend: Array
    length: float
    trust: Array | float = 1.0


def speed_profile(path: Path, envelope: Envelope) -> Array:
    """Speed, m/s, at the points of the path, shape (n,)."""
    ds = path.length / len(path.curvature)
    v = cornering_speed(path, envelope)
    start = int(np.argmin(v))  # the slowest point is on its limit: one pass from there closes the lap
    a, b = normal_share(path.grade, path.bank, path.bend, path.curvature)
    uphill, across = GRAVITY * np.sin(path.grade), GRAVITY * np.sin(path.bank)
    columns = (v, path.curvature, uphill, across, a, b, np.broadcast_to(path.trust, v.shape))
    rows = [np.roll(column, -start).tolist() for column in columns]
    v2 = [u * u for u in rows[0]]
    v2.append(v2[0])
    for row in rows[1:]:
        row.append(row[0])
    _forwards(v2, rows[1:], 2.0 * ds, envelope)
    _backwards(v2, rows[1:], 2.0 * ds, envelope)
    return np.roll(np.sqrt(np.array(v2[:-1])), start)


def cornering_speed(path: Path, envelope: Envelope) -> Array:
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


# Both passes are sequential and run while the car drives, so their formulas stand in the loops: calls would double the
# time. used: share of the lateral limit; grip: specific force left on the friction ellipse; n: load over weight.


def _forwards(v2: Row, path: list[Row], step: float, envelope: Envelope) -> None:
    """Limit v2, m2/s2, to what the engine reaches over each `step` of twice the distance, m; in place."""
    kappa, uphill, across, level, dip, trust = path
    (c0, c2), (l0, l2), (d0, d2) = envelope.lateral, envelope.drive, envelope.drag
    traction, power = envelope.traction, envelope.power
    u = v2[0]
    for i in range(1, len(v2)):
        n, t = max(level[i - 1] + dip[i - 1] * u, MIN_NORMAL), trust[i - 1]
        used = (u * kappa[i - 1] + across[i - 1]) / (t * (n * c0 + c2 * u))
        left = 1.0 - used * used
        force = t * (n * l0 + l2 * u) * sqrt(left) if left > 0.0 else 0.0
        force = min(force, traction)
        if force * force * u > power * power:
            force = power / sqrt(u)
        u = u + step * (force - (d0 + d2 * u) - uphill[i - 1])
        u = v2[i] = min(v2[i], max(u, 1.0))


def _backwards(v2: Row, path: list[Row], step: float, envelope: Envelope) -> None:
    """Limit v2, m2/s2, to what the brakes shed over each `step` of twice the distance, m; in place."""
    kappa, uphill, across, level, dip, trust = path
    (c0, c2), (l0, l2), (d0, d2) = envelope.lateral, envelope.brake, envelope.drag
    u = v2[-1]
    for i in range(len(v2) - 2, -1, -1):
        n, t = max(level[i + 1] + dip[i + 1] * u, MIN_NORMAL), trust[i + 1]
        used = (u * kappa[i + 1] + across[i + 1]) / (t * (n * c0 + c2 * u))
        left = 1.0 - used * used
        grip = t * (n * l0 + l2 * u) * sqrt(left) if left > 0.0 else 0.0
        loss = grip + (d0 + d2 * u) + uphill[i + 1]
        if loss > 0.0:
            u = u + step * loss
        if u > v2[i]:
            u = v2[i]
        else:
            v2[i] = u
