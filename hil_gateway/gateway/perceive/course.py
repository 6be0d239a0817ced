"""How the car moves by its position fixes alone: course, speed and turn rate, independent of tyres, wheels and IMU.

A parabola in time is fitted to the newest fixes (least squares); its end is carried on to now. With 0.02 m of noise at
20 Hz the course at 45 m/s is right within 0.006 rad, the speed within 0.25 m/s and the turn rate within 0.03 rad/s: the
slower the car, the less its fixes say of how it turns.
"""

from __future__ import annotations

import cmath
import math
from collections import deque
from typing import NamedTuple

from hil_gateway.gateway.perceive.duration import CONTRADICTED_S, JITTER_S, SILENT_S, UNSEEN_S
from hil_gateway.gateway.perceive.positions.fixes import Fixes
from hil_gateway.observer.bank import GATE
from hil_gateway.observer.observer import SLOWEST
from hil_gateway.process.clock import NS_PER_S

FITTED = 8
"""fixes: 0.35 s at 20 Hz; fewer let noise through, more answer late"""
COURSE_WINDOW = 38
"""periods of the gateway: the time the fixes behind a course span, and half a fix"""
OLDEST_S = CONTRADICTED_S + SILENT_S
"""age of the newest fix beyond which the course is no longer known: two fixes were lost"""
WEAVES_M = 0.2
"""of a car that weaves from a parabola, beside what fixes scatter"""
LATERAL = 7.0
"""m/s2 that a course may be off gyro and force, across: side slip that builds up, and its lag"""


class Course(NamedTuple):
    """Place (m), direction of motion (rad), speed (m/s), turn rate (rad/s) and what noise makes of that (rad/s,
    standard deviation)."""

    x: float
    y: float
    course: float
    speed: float
    turn_rate: float
    turn_noise: float = 0.0

    @property
    def turn_within(self) -> float:
        """What the turn rate is at most off where the fixes are right, rad/s."""
        return math.hypot(LATERAL / self.speed, GATE * self.turn_noise)


def apart_at_most(noise: float) -> float:
    """Of a fix with so much noise from where it is expected, m."""
    return WEAVES_M + GATE * noise


class CourseReader:
    """Keeps the newest fixes."""

    def __init__(self, noise: float) -> None:
        """`noise` of a fix, m."""
        self._noise, self._across = noise, GATE * noise
        self._fixes: deque[tuple[int, complex]] = deque(maxlen=FITTED)
        """stamp and place: x + i y, m"""
        self._seq = 0
        self._fit: tuple[_Parabola, int] | None = None
        """of time since its stamp, and that stamp"""

    def step(self, now_ns: int, fixes: Fixes) -> Course | None:
        """Course at `now_ns`; None where fixes are missing, slow or scattered."""
        if fixes.seq != self._seq:
            self._seq = fixes.seq
            if self._fixes and fixes.stamp_ns - self._fixes[-1][0] > UNSEEN_S * NS_PER_S:
                self._fixes.clear()
            self._fixes.append((fixes.stamp_ns, complex(fixes.x, fixes.y)))
            self._fit = self._fitted()
        if self._fit is None or now_ns - self._fit[1] > OLDEST_S * NS_PER_S:
            return None
        parabola, stamp_ns = self._fit
        return parabola.course((now_ns - stamp_ns) / NS_PER_S, self._noise)

    def _fitted(self) -> tuple[_Parabola, int] | None:
        newest_ns = self._fixes[-1][0]
        places = [place for _, place in self._fixes]
        times = [(stamp - newest_ns) / NS_PER_S for stamp, _ in self._fixes]
        if len(times) < FITTED or sorted(set(times)) != times:
            return None
        parabola = _Parabola.fitted(times, places)
        speed = abs(parabola.velocity)
        if speed < SLOWEST:
            return None
        ahead = parabola.velocity / speed
        off = [(place - parabola.at(t)) / ahead for t, place in zip(times, places, strict=True)]
        along, across = math.hypot(*(o.real for o in off)), math.hypot(*(o.imag for o in off))
        scattered = max(along / (JITTER_S * speed), across / self._across) > math.sqrt(FITTED)
        return None if scattered else (parabola, newest_ns)


class _Parabola(NamedTuple):
    """Place over time; x + i y of it, m, of its velocity, m/s, and of half its acceleration, m/s2; what a metre of
    noise makes of that, 1/s2."""

    place: complex
    velocity: complex
    half: complex
    noisy: float

    @classmethod
    def fitted(cls, times: list[float], places: list[complex]) -> _Parabola:
        """Least squares, by polynomials 1, p, q that are orthogonal on these times."""
        count, middle = len(times), sum(times) / len(times)
        p = [t - middle for t in times]
        spread = sum(t * t for t in p)
        skew, mean = sum(t**3 for t in p) / spread, spread / count
        q = [t * t - skew * t - mean for t in p]
        level = sum(places) / count
        slope = sum(t * z for t, z in zip(p, places, strict=True)) / spread
        bent = sum(t * t for t in q)
        half = sum(t * z for t, z in zip(q, places, strict=True)) / bent
        place = level - slope * middle + half * (middle**2 + skew * middle - mean)
        return cls(place, slope - half * (2.0 * middle + skew), half, 1.0 / math.sqrt(bent))

    def at(self, t: float) -> complex:
        """Place then."""
        return self.place + t * (self.velocity + t * self.half)

    def course(self, t: float, noise: float) -> Course | None:
        """What it means then, with so much `noise` of a fix, m; None where it is slow."""
        velocity, place = self.velocity + 2.0 * t * self.half, self.at(t)
        speed = abs(velocity)
        if speed < SLOWEST:
            return None
        turn = 2.0 * (self.half * velocity.conjugate()).imag / speed**2
        return Course(place.real, place.imag, cmath.phase(velocity), speed, turn, 2.0 * noise * self.noisy / speed)
