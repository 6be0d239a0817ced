"""The fastest quasi-steady speed along a given line: what the car can do at every place, then a pass each way."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hil_gateway.plant.physics.parameters import CarParameters
from hil_gateway.plant.physics.road import Slopes, body_gravity
from hil_gateway.plant.referee.limit_envelope import SLOWEST, TOP_SPEED, LimitEnvelope
from hil_gateway.process.arrays import Array

SPEED_STEP = 0.5
"""m/s between the speeds at which a place is looked at"""
GRID = np.arange(SLOWEST, TOP_SPEED + 0.5 * SPEED_STEP, SPEED_STEP)
EDGE = 0.999
"""share of the largest lateral force beyond which nothing is left along"""


class LimitPath(NamedTuple):
    """A closed line at equal steps of `step` m, arrays (n,): yaw and its offset from the track's heading (rad),
    curvature (1/m), slopes of the road."""

    step: float
    yaw: Array
    off: Array
    curvature: Array
    slopes: Slopes


@dataclass(frozen=True)
class Reach:
    """At every place (rows) and speed of `GRID` (columns): largest and least change of speed, m/s2, and the fastest
    speed at which the curvature can be held, m/s, shape (n,)."""

    rise: Array
    fall: Array
    cornering: Array


def reach(path: LimitPath, envelope: LimitEnvelope, car: CarParameters) -> Reach:
    """What the car can do along a line, whatever it did before."""
    v = GRID[None, :]
    curvature, off = path.curvature[:, None], path.off[:, None]
    slopes = Slopes(*(values[:, None] for values in path.slopes))
    along, left, normal = body_gravity(slopes, off, v, v * curvature, np)
    head, push = _wind(path, car)
    head = np.broadcast_to(head[:, None], normal.shape)
    lateral = v * v * curvature - left - push[:, None] * v / car.mass
    peak = envelope.peak(lateral > 0, head, np.broadcast_to(v, normal.shape), normal)
    share = lateral / peak
    at = (share, head, np.broadcast_to(v, normal.shape), normal)
    rise, fall = envelope.along(envelope.drive, *at), envelope.along(envelope.brake, *at)
    return Reach(rise + along, fall + along, _fastest(np.abs(share)))


def _wind(path: LimitPath, car: CarParameters) -> tuple[Array, Array]:
    """Head wind, m/s, and the side force of the cross wind over speed, N s/m, at every place."""
    cos, sin = np.cos(path.yaw), np.sin(path.yaw)
    head = -(car.wind_x * cos + car.wind_y * sin)
    return head, car.side * (car.wind_y * cos - car.wind_x * sin)


def _fastest(share: Array) -> Array:
    """Speed up to which the share of the lateral force stays within one, from the slowest on, m/s."""
    beyond = share > EDGE
    first = np.where(beyond.any(axis=1), beyond.argmax(axis=1), len(GRID))
    rows, at, before = np.arange(len(share)), np.clip(first, 1, len(GRID) - 1), np.clip(first - 1, 0, None)
    rise = share[rows, at] - share[rows, before]
    part = np.clip((EDGE - share[rows, before]) / np.where(rise > 0, rise, 1.0), 0.0, 1.0)
    return np.asarray(np.where(first == len(GRID), GRID[-1], GRID[before] + part * (GRID[at] - GRID[before])))


def fastest_profile(path: LimitPath, envelope: LimitEnvelope, car: CarParameters) -> Array:
    """Speed, m/s, shape (n,), of the quickest quasi-steady lap along the line."""
    can = reach(path, envelope, car)
    v = _run(can.cornering, can.rise, path.step)
    return _run(v[::-1], -can.fall[::-1], path.step)[::-1]


def _run(limit: Array, rate: Array, step: float) -> Array:
    """`limit` with its rise along the array held to `rate` (over `GRID`); two laps, so that it closes on itself."""
    v, rates = limit.tolist(), rate.tolist()
    n, last = len(v), len(GRID) - 2
    start = int(np.argmin(limit))
    for i in range(start + 1, start + 2 * n):
        before, here = v[(i - 1) % n], i % n
        place = (before - SLOWEST) / SPEED_STEP
        k = min(max(int(place), 0), last)
        row = rates[(i - 1) % n]
        gain = row[k] + (place - k) * (row[k + 1] - row[k])
        v[here] = min(v[here], max(before * before + 2.0 * gain * step, SLOWEST**2) ** 0.5)
    return np.array(v)


def lap_time(speed: Array, step: float) -> float:
    """Time of a lap over equal steps, s."""
    return float(np.sum(2.0 * step / (speed + np.roll(speed, -1))))
