"""How the car moves by its position fixes alone: course, speed and turn rate, independent of tyres, wheels and IMU.

A parabola in time is fitted to the newest fixes (least squares); its end is carried on to now. With 0.02 m of noise at
20 Hz the course at 45 m/s is right within 0.006 rad, the speed within 0.25 m/s and the turn rate within 0.03 rad/s.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from hil_gateway.gateway.perceive.duration import JITTER_S, UNSEEN_S
from hil_gateway.gateway.perceive.positions.fixes import Fixes
from hil_gateway.process.arrays import Array
from hil_gateway.process.clock import NS_PER_S

FITTED = 8
"""fixes: 0.35 s at 20 Hz; fewer let noise through, more answer late"""
COURSE_WINDOW = 38
"""periods of the gateway: the time the fixes behind a course span, and half a fix"""
OLDEST_S = 0.15
"""age of the newest fix beyond which the course is no longer known: two fixes were lost"""
SLOWEST = 8.0
"""m/s: slower, noise turns the course"""
WEAVES_M, DEVIATIONS = 0.15, 7.5
"""of a car that weaves from a parabola, and of what fixes scatter beside it in standard deviations: further apart,
fixes are wrong"""
DOUBTED = 1.0 / 3.0
"""of that, root mean square, beyond which fixes say no course"""


class Course(NamedTuple):
    """Place (m), direction of motion (rad), speed (m/s), turn rate (rad/s) and its growth of speed (m/s2)."""

    x: float
    y: float
    course: float
    speed: float
    turn_rate: float
    gain: float


def apart_at_most(noise: float) -> float:
    """Of a fix with so much noise from where it is expected, m."""
    return WEAVES_M + DEVIATIONS * noise


class CourseReader:
    """Keeps the newest fixes."""

    def __init__(self, noise: float) -> None:
        """`noise` of a fix, m."""
        self._across = DOUBTED * apart_at_most(noise)
        self._fixes: deque[tuple[int, float, float]] = deque(maxlen=FITTED)
        self._seq = 0
        self._fit: tuple[Array, int] | None = None
        """coefficients (3, 2) of time since its stamp, and that stamp"""

    def step(self, now_ns: int, fixes: Fixes) -> Course | None:
        """Course at `now_ns`; None where fixes are missing, slow or scattered."""
        if fixes.seq != self._seq:
            self._seq = fixes.seq
            if self._fixes and fixes.stamp_ns - self._fixes[-1][0] > UNSEEN_S * NS_PER_S:
                self._fixes.clear()
            self._fixes.append((fixes.stamp_ns, fixes.x, fixes.y))
            self._fit = self._fitted()
        if self._fit is None or now_ns - self._fit[1] > OLDEST_S * NS_PER_S:
            return None
        coefficients, stamp_ns = self._fit
        return _moving(coefficients.tolist(), (now_ns - stamp_ns) / NS_PER_S)

    def _fitted(self) -> tuple[Array, int] | None:
        newest_ns = self._fixes[-1][0]
        t = np.array([(stamp - newest_ns) / NS_PER_S for stamp, _, _ in self._fixes])
        if len(t) < FITTED or not (np.diff(t) > 0.0).all():
            return None
        places = np.array([place for _, *place in self._fixes])
        powers = np.vander(t, 3, increasing=True)
        coefficients = np.linalg.lstsq(powers, places, rcond=None)[0]
        residual = np.sqrt(np.mean(_turned(places - powers @ coefficients, coefficients[1]) ** 2, axis=0))
        speed = math.hypot(*coefficients[1])
        scattered = residual[1] > self._across or residual[0] > JITTER_S * speed
        return None if speed < SLOWEST or scattered else (coefficients, newest_ns)


def _turned(vectors: Array, ahead: Array) -> Array:
    """Vectors (n, 2) as along and across the direction `ahead`."""
    along = ahead / max(math.hypot(*ahead), 1e-9)
    return np.stack([vectors @ along, vectors @ np.array([-along[1], along[0]])], axis=1)


def _moving(coefficients: list[list[float]], t: float) -> Course | None:
    (x, y), (vx, vy), (half_ax, half_ay) = coefficients
    ax, ay = 2.0 * half_ax, 2.0 * half_ay
    east, north = vx + ax * t, vy + ay * t
    speed = math.hypot(east, north)
    if speed < SLOWEST:
        return None
    gain, turn = (ax * east + ay * north) / speed, (east * ay - north * ax) / speed**2
    return Course(x + t * (vx + half_ax * t), y + t * (vy + half_ay * t), math.atan2(north, east), speed, turn, gain)
