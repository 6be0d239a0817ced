"""An IMU whose axes have lost their noise.

Noise of an axis is its own, and that of two does not fall by an order of magnitude while the car drives: what has lost
it no longer measures. The observer finds it only when the car next turns otherwise, which is late in a bend.
"""

from __future__ import annotations

from collections import deque

from hil_gateway.bus.messages import VehicleState
from hil_gateway.car.car import Car
from hil_gateway.observer.observer import SLOWEST
from hil_gateway.settings.gateway import PERIOD_S

QUIET = 0.14
"""of its usual noise that one of two axes has at least: 0.145 was the least of a gyro alone on a measured drive of an
AV-21 (25 Hz, filtered, mostly motion), 0.25 of an axis on simulated ones"""
WINDOW = 20
"""periods (0.2 s) of noise; a mean of so many differs from the usual one by a fifth"""
USUAL = 500
"""periods (5 s) over which the usual noise is learnt"""
RESOLVED = 6.0
"""steps of the report of usual noise from which less can be told"""


class QuietMonitor:
    """What it has `found` holds until the car stands."""

    def __init__(self, car: Car) -> None:
        reports, imu = car.codec.signals.reports, next(iter(car.imus))
        axes = ("yaw_rate", "ay", "ax")
        self._axes = [_Noise(RESOLVED * abs(reports[f"imu.{imu}.{name}"].scale)) for name in axes]
        self.found = False

    def step(self, state: VehicleState, speed: float) -> None:
        """One period; `speed` in m/s."""
        self.found = self.found and speed > 0.0
        imu = state.sources["imu"]
        if speed < SLOWEST or not imu.valid or imu.age_s is None or imu.age_s >= 2 * PERIOD_S:
            for axis in self._axes:  # two were missed: all that changed comes at once
                axis.forget()
        elif imu.age_s < PERIOD_S:  # else it is the one before
            readings = state.yaw_rate, state.ay, state.ax
            fell = [axis.fell(reading) for axis, reading in zip(self._axes, readings, strict=True)]
            self.found = self.found or sum(fell) > 1


class _Noise:
    """Second differences of one axis, lately and usually."""

    def __init__(self, resolved: float) -> None:
        self._resolved = resolved
        self._readings, self._lately = deque[float](maxlen=3), deque[float](maxlen=WINDOW)
        self._usual, self._learnt = 0.0, 0

    def forget(self) -> None:
        """Readings are missing."""
        self._readings.clear()
        self._lately.clear()

    def fell(self, reading: float) -> bool:
        """Whether there is hardly any left of what was usual."""
        self._readings.append(reading)
        if len(self._readings) == 3:
            before, last, now = self._readings
            self._lately.append(abs(now - 2.0 * last + before))
        if len(self._lately) < WINDOW:
            return False
        self._learnt = min(self._learnt + 1, USUAL)
        self._usual += (self._lately[0] - self._usual) / self._learnt
        known = self._learnt == USUAL and self._usual > self._resolved
        return known and sum(self._lately) / WINDOW < QUIET * self._usual
