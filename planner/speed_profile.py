"""Fastest speed along a given closed path within an envelope: forward-backward pass.

Cornering speed first, then what the engine can reach going forwards and what the brakes can shed going backwards, each
on the friction ellipse with grade and bank (Kapania, Subosits & Gerdes 2016). All in specific forces.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from hil_gateway.vehicle import GRAVITY
from planner.envelope import Array, Envelope


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
    _, kappa, uphill, across = rows
    for i in range(len(v2) - 1):
        gain = _driving(v2[i], kappa[i], across[i], envelope) - _drag(v2[i], envelope) - uphill[i]
        v2[i + 1] = min(v2[i + 1], max(v2[i] + 2.0 * ds * gain, 1.0))
    for i in range(len(v2) - 1, 0, -1):
        loss = _grip_left(v2[i], kappa[i], across[i], envelope) + _drag(v2[i], envelope) + uphill[i]
        v2[i - 1] = min(v2[i - 1], v2[i] + 2.0 * ds * max(loss, 0.0))
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


def _grip_left(v2: float, kappa: float, across: float, envelope: Envelope) -> float:
    """Longitudinal specific force left on the friction ellipse, m/s2."""
    used = (v2 * kappa + across) / (envelope.lateral[0] + envelope.lateral[1] * v2)
    return (envelope.longitudinal[0] + envelope.longitudinal[1] * v2) * sqrt(max(1.0 - used * used, 0.0))


def _driving(v2: float, kappa: float, across: float, envelope: Envelope) -> float:
    return min(_grip_left(v2, kappa, across, envelope), envelope.traction, envelope.power / sqrt(v2))


def _drag(v2: float, envelope: Envelope) -> float:
    return envelope.drag[0] + envelope.drag[1] * v2
