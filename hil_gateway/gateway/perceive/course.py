"""How the car moves by its position fixes alone: course, speed and turn rate, independent of tyres, wheels and IMU.

A parabola in time is fitted to the newest fixes (least squares); its end is carried on to now. With 0.02 m of noise at
20 Hz the course at 45 m/s is right within 0.006 rad, the speed within 0.25 m/s and the turn rate within 0.03 rad/s: the
slower the car, the less its fixes say of how it turns.
"""

from __future__ import annotations

import cmath
import math
from typing import NamedTuple

import numpy as np

from hil_gateway.gateway.perceive.duration import CONTRADICTED_S, JITTER_S, SILENT_S
from hil_gateway.observer.bank import GATE
from hil_gateway.observer.observer import SLOWEST
from hil_gateway.process.arrays import Array

COURSE_WINDOW = 38
"""periods of the gateway that the fixes behind a course span: fewer let noise through, more answer late"""
LEAST_FIXES = 4
"""of a course: one more than a parabola goes through"""
OLDEST_S = CONTRADICTED_S + SILENT_S
"""age of the newest fix beyond which the course is no longer known: two fixes were lost"""
WEAVES_M = 0.2
"""of a car that weaves from a parabola, beside what fixes scatter"""


class Course(NamedTuple):
    """Place (m), direction of motion (rad), speed (m/s), turn rate and its standard deviation (rad/s)."""

    x: float
    y: float
    course: float
    speed: float
    turn_rate: float
    turn_std: float


def apart_at_most(noise: float) -> float:
    """Of a fix with so much noise from where it is expected, m."""
    return WEAVES_M + GATE * noise


class Parabola(NamedTuple):
    """Place over time; x + i y of it, m, of its velocity, m/s, and of half its acceleration and the standard deviation
    of that, m/s2."""

    place: complex
    velocity: complex
    half: complex
    half_std: float

    @classmethod
    def fitted(cls, times: Array, places: Array, noise: float) -> Parabola:
        """Least squares; arrays (n,), `noise` of a place, m."""
        powers = np.vander(times, 3, increasing=True)
        surer = np.linalg.inv(powers.T @ powers)
        place, velocity, half = (surer @ (powers.T @ places)).tolist()
        return cls(place, velocity, half, noise * math.sqrt(surer[2, 2]))

    def scatter(self, times: Array, places: Array, noise: float) -> float:
        """Of those places at those times beside it, over what `noise` (m) and fixes that come late explain."""
        speed = abs(self.velocity)
        off = (places - self.place - times * (self.velocity + times * self.half)) / (self.velocity / speed)
        along, across = np.linalg.norm(off.real), np.linalg.norm(off.imag)
        return float(max(along / (JITTER_S * speed), across / (GATE * noise))) / math.sqrt(len(times))

    def at(self, t: float) -> complex:
        """Place then."""
        return self.place + t * (self.velocity + t * self.half)

    def course(self, t: float) -> Course | None:
        """What it means then; None where it is slow."""
        velocity, place = self.velocity + 2.0 * t * self.half, self.at(t)
        speed = abs(velocity)
        if speed < SLOWEST:
            return None
        turn = 2.0 * (self.half * velocity.conjugate()).imag / speed**2
        turn_std = 2.0 * self.half_std / speed
        return Course(place.real, place.imag, cmath.phase(velocity), speed, turn, turn_std)
