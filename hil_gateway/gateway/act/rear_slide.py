"""A rear axle that slides under the brakes of a stop is let go until it grips.

A car that turns by r and is pushed aside by a_y changes its side slip by a_y / v - r. Where that adds up to the outside
of the bend, the rear tyres give less aside than the bend takes: what they brake with is what they lack. Gyro and
accelerometer alone tell it, so that steering which fails, or whose report is wrong, looks like no slide.
"""

from __future__ import annotations

from hil_gateway.gateway.perceive.motion import Motion
from hil_gateway.gateway.settings import PERIOD_S

FORGOTTEN_S = 0.5
"""time constant, s: gravity on a bank and bias (0.03 rad/s at 60 m/s) come to 0.015 rad"""
SLIDES = 0.035
"""rad of side slip that has built up; turning in takes up to 0.02, a car that spins reaches 0.05 within 0.4 s"""
JUDGED_FROM = 12.0
"""m/s: slower, a car turns by its steering more than by side slip"""
LEAST_PRESSURE = 0.1e6
"""Pa that are left: with less the brakes do not bite"""
PRESS_AGAIN = 1e6
"""Pa/s: the usual pressure after two seconds, as long as a bend lasts; pressed again at once the axle slides again"""


class RearSlide:
    """The most the rear circuit may press, once a period."""

    def __init__(self, most: float) -> None:
        """`most`: largest pressure of the brakes, Pa."""
        self._most = self.rear_most = most
        """Pa"""
        self._slip = 0.0
        """rad of side slip, to the right, that has built up lately"""

    def step(self, motion: Motion) -> None:
        """In every period, so that a stop begins with what is known; without a gyro nothing is told."""
        told = motion.by_gyro and motion.speed > JUDGED_FROM
        growth = motion.yaw_rate - motion.ay / max(motion.speed, JUDGED_FROM)
        self._slip = self._slip + PERIOD_S * (growth - self._slip / FORGOTTEN_S) if told else 0.0
        to_the_outside = self._slip if motion.ay > 0.0 else -self._slip
        pressed = min(self.rear_most + PRESS_AGAIN * PERIOD_S, self._most)
        self.rear_most = LEAST_PRESSURE if to_the_outside > SLIDES else pressed
