"""Loads judged by the plant at every step: friction used by each axle, slides, spins. Nothing that drives listens."""

from __future__ import annotations

import math

from hil_gateway.plant.car import STEP_S, Car

JUDGED_SPEED = 5.0
"""m/s; slower, slip is a matter of the clutch and of parking, and nothing can be lost by it"""
SLIDE_S = 0.2
"""beyond the peak for longer is a slide; the time a controller with 20 plans a second needs to answer is half of it"""
SPUN_RAD = 0.7
"""angle between the car's nose and its motion beyond which no steering lock (0.28 rad) brings it back"""


class LoadJudge:
    """Feed it with every step of the car."""

    def __init__(self, car: Car) -> None:
        self._car = car
        self._spell = 0
        self._spun = False
        self.friction = (0.0, 0.0)
        """largest force of the front and rear axle over the most its tyres could give under their loads then"""
        self.longest_over_s = 0.0
        """longest time on end that an axle's combined slip was beyond that of the peak force"""
        self.slides = 0
        self.spins = 0

    def step(self) -> None:
        """Take in the step just made."""
        car = self._car
        vx, vy = car.velocity
        if abs(vx) < JUDGED_SPEED and abs(vy) < JUDGED_SPEED:
            self._spell, self._spun = 0, False
            return
        (front, rear), (use_front, use_rear, slip_front, slip_rear) = self.friction, car.tyre_use
        if use_front > front or use_rear > rear:
            self.friction = max(front, use_front), max(rear, use_rear)
        self._over(slip_front > 1.0 or slip_rear > 1.0)
        spun = abs(math.atan2(vy, vx)) > SPUN_RAD
        self.spins += spun and not self._spun
        self._spun = spun

    def _over(self, beyond: bool) -> None:
        self._spell = self._spell + 1 if beyond else 0
        if beyond:
            self.longest_over_s = max(self.longest_over_s, self._spell * STEP_S)
            self.slides += self._spell == round(SLIDE_S / STEP_S)
