"""What the car's sensors make of its motion: mounting, scale, bias, noise. Quantisation is that of the CAN signals."""

from __future__ import annotations

import math

import numpy as np

from hil_gateway.config import OriginConfig
from hil_gateway.plant.car import Car
from hil_gateway.plant.physics.parameters import SensorParameters
from hil_gateway.track.geodesy import LocalMap

BLOCK = 4096
WHEELS = tuple((f"wheel_speed_{wheel.upper()}", f"spin_{wheel}") for wheel in ("fl", "fr", "rl", "rr"))

WANDER_M = 1.5
"""standard deviation of a receiver without corrections, assumed: satellites' clocks and orbits, ionosphere. The GPS
Standard Positioning Service promises 8 m for 95 %"""
WANDER_S = 600.0
"""its time constant: the ionosphere and the satellites' geometry change in tens of minutes"""
SMOOTHED = 0.1
"""m a normal number: what smoothing with the carrier leaves of noise and multipath"""
READING_S = 0.1
"""period of its readings, by which each is late"""


class Noise:
    """Standard normal numbers in blocks: drawing them one by one would cost more than the physics."""

    def __init__(self, seed: int) -> None:
        self._generator = np.random.default_rng(seed)
        self._block: list[float] = []

    def __call__(self) -> float:
        if not self._block:
            self._block = self._generator.standard_normal(BLOCK).tolist()
        return self._block.pop()


class Sensors:
    """Readings in SI, as signals of the DBC."""

    def __init__(self, car: Car, parameters: SensorParameters, origin: OriginConfig, seed: int) -> None:
        self._car = car
        self._p = parameters
        self._map = LocalMap(origin)
        self._noise = Noise(seed)
        self._cos, self._sin = math.cos(parameters.imu_yaw), math.sin(parameters.imu_yaw)
        self.mylaps, self.marelli = (StandaloneReceiver(car, origin, self._noise) for _ in range(2))

    def imu(self) -> dict[str, float]:
        """Specific force and rates where and how the IMU is mounted, m/s2 and rad/s.

        a_imu = a + yaw_acc x r - yaw_rate^2 r, turned by the mounting angle, plus bias.
        """
        p, car, noise = self._p, self._car, self._noise
        rate = car["yaw_rate"]
        x = car.output("ax") - rate * rate * p.imu_x
        y = car.output("ay") + car.output("yaw_acc") * p.imu_x
        return {
            "imu_ax": self._cos * x + self._sin * y + p.imu_bias_x + p.acceleration_noise * noise(),
            "imu_ay": self._cos * y - self._sin * x + p.imu_bias_y + p.acceleration_noise * noise(),
            "imu_az": car.output("az") + p.acceleration_noise * noise(),
            "imu_yaw_rate": rate + p.yaw_rate_noise * noise(),
            "imu_roll_rate": p.yaw_rate_noise * noise(),
        }

    def wheel_speeds(self) -> dict[str, float]:
        """Circumferential speeds, m/s; the sensor knows no direction."""
        car, draw = self._car, self._noise
        radius = car.parameters.car.wheel_radius * self._p.speed_scale
        noise = 0.0 if car.standing else self._p.speed_noise
        return {signal: abs(car[spin] * radius + noise * draw()) for signal, spin in WHEELS}

    def steering(self) -> float:
        """Road-wheel angle as the motor's sensor has it, rad."""
        return self._car["steer"] + self._p.steer_noise * self._noise()

    def position(self) -> tuple[float, float]:
        """Latitude and longitude, rad."""
        noise = self._p.position_noise
        latitude, longitude = self._map.to_geodetic(
            self._car["x"] + noise * self._noise(), self._car["y"] + noise * self._noise()
        )
        return math.radians(latitude), math.radians(longitude)


class StandaloneReceiver:
    """Receiver of a transponder: no corrections, an error that wanders, each reading late by one period."""

    def __init__(self, car: Car, origin: OriginConfig, noise: Noise) -> None:
        self._car, self._map, self._noise = car, LocalMap(origin), noise
        self._wander: tuple[float, float] | None = None
        self._was = car["x"], car["y"]

    def position(self) -> tuple[float, float]:
        """Latitude and longitude, rad; once in `READING_S`."""
        drawn = self._noise(), self._noise()
        if self._wander is None:
            self._wander = WANDER_M * drawn[0], WANDER_M * drawn[1]
        step = WANDER_M * math.sqrt(2.0 * READING_S / WANDER_S)
        x, y = (old + step * d - old * READING_S / WANDER_S for old, d in zip(self._wander, drawn, strict=True))
        self._wander = x, y
        was, self._was = self._was, (self._car["x"], self._car["y"])
        latitude, longitude = self._map.to_geodetic(was[0] + x + SMOOTHED * drawn[0], was[1] + y + SMOOTHED * drawn[1])
        return math.radians(latitude), math.radians(longitude)
