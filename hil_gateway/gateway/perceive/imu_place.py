"""An inertial sensor's readings, turned and moved to the centre of gravity as its mounting is declared.

A point at r from the centre of gravity feels a + dw/dt x r - w^2 r (rigid body, plane motion); the sensor reads that in
axes turned by its mounting angle. Where both are zero nothing is done. The yaw acceleration is taken over `JITTER_S`,
three readings: 0.1 rad/s2 of noise for a gyro of 0.1 deg/s.
"""

from __future__ import annotations

import math

from hil_gateway.car.car import Imu
from hil_gateway.gateway.perceive.duration import JITTER_S
from hil_gateway.settings.gateway import PERIOD_S


class ImuPlace:
    """Of one sensor; `to_centre` once a period."""

    def __init__(self, imu: Imu) -> None:
        self._cos, self._sin = math.cos(imu.yaw), math.sin(imu.yaw)
        self._x, self._y = imu.x, imu.y
        self._nothing = imu.x == imu.y == imu.yaw == 0.0
        self._rates: list[tuple[float, float]] = []

    def to_centre(self, t_s: float, ax: float, ay: float, yaw_rate: float) -> tuple[float, float]:
        """Specific force at the centre of gravity in body axes, m/s2, at the time `t_s`."""
        if self._nothing:
            return ax, ay
        felt_x, felt_y = self._cos * ax - self._sin * ay, self._sin * ax + self._cos * ay
        gained = self._yaw_acceleration(t_s, yaw_rate)
        squared = yaw_rate * yaw_rate
        return felt_x + squared * self._x + gained * self._y, felt_y + squared * self._y - gained * self._x

    def _yaw_acceleration(self, t_s: float, yaw_rate: float) -> float:
        if not self._rates or t_s > self._rates[-1][0]:
            self._rates.append((t_s, yaw_rate))
        while len(self._rates) > 2 and self._rates[1][0] <= t_s - JITTER_S:
            self._rates.pop(0)
        (t0, before), (t1, now) = self._rates[0], self._rates[-1]
        return (now - before) / (t1 - t0) if PERIOD_S <= t1 - t0 <= 3 * JITTER_S else 0.0
