"""What the car's sensors make of its motion: mounting, scale, bias, noise. Quantisation is that of the CAN signals."""

from __future__ import annotations

import math

import numpy as np

from can_dbc.quantities import WHEELS
from hil_gateway.car.car import Car as Platform
from hil_gateway.config import OriginConfig
from hil_gateway.plant.car import Car
from hil_gateway.plant.physics.chassis import further_left
from hil_gateway.plant.physics.parameters import SensorParameters
from hil_gateway.track.geodesy import LocalMap

BLOCK = 4096
WHEEL_SPEEDS = tuple((f"wheel_speed_{wheel}", f"spin_{wheel}") for wheel in WHEELS)
Values = dict[str, float]

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


class SimulatedSensors:
    """Readings in SI, as quantities of a platform: its sensors are where it declares them, and off by what is not."""

    def __init__(
        self, car: Car, parameters: SensorParameters, platform: Platform, origin: OriginConfig, seed: int
    ) -> None:
        self._car = car
        self._p = parameters
        self._map = LocalMap(origin)
        self._noise = Noise(seed)
        self._further_left = further_left(car.parameters.car)
        self._imus = {
            name: _Mounting(name, imu.x + parameters.imu_x, imu.y, imu.yaw + parameters.imu_yaw)
            for name, imu in platform.imus.items()
        }
        self._first, *others = platform.receivers
        self._standalone = {name: StandaloneReceiver(car, origin, self._noise) for name in others}

    def imu(self, name: str) -> Values:
        """Specific force and rates where and how an IMU is mounted, m/s2 and rad/s.

        a_imu = a + yaw_acc x r - yaw_rate^2 r, turned by the mounting angle, plus bias.
        """
        p, car, noise, at = self._p, self._car, self._noise, self._imus[name]
        rate, gained = car["yaw_rate"], car.output("yaw_acc")
        x = car.output("ax") - rate * rate * at.x - gained * at.y
        y = car.output("ay") - rate * rate * at.y + gained * at.x
        ax, ay, az, yaw_rate, roll_rate, pitch_rate = at.quantities
        return {
            ax: at.cos * x + at.sin * y + p.imu_bias_x + p.acceleration_noise * noise(),
            ay: at.cos * y - at.sin * x + p.imu_bias_y + p.acceleration_noise * noise(),
            az: car.output("az") + p.acceleration_noise * noise(),
            yaw_rate: rate + p.yaw_rate_noise * noise(),
            roll_rate: p.yaw_rate_noise * noise(),
            pitch_rate: 0.0,
        }

    def wheel_speeds(self) -> Values:
        """Circumferential speeds, m/s; the sensor knows no direction.

        A car whose physics is narrower than its track (`lever_arm`) shows what wheels at their places would: equal ones
        in a bend are those of no car.
        """
        car, draw, scale = self._car, self._noise, self._p.speed_scale
        radius, turning = car.parameters.car.wheel_radius, car["yaw_rate"]
        noise = 0.0 if car.standing else self._p.speed_noise
        return {
            signal: abs(scale * (car[spin] * radius - further * turning) + noise * draw())
            for (signal, spin), further in zip(WHEEL_SPEEDS, self._further_left, strict=True)
        }

    def steering(self) -> float:
        """Road-wheel angle as the motor's sensor has it, rad."""
        return self._car["steer"] + self._p.steer_noise * self._noise()

    def position(self, name: str) -> Values:
        """Latitude and longitude of a receiver, rad; the first has corrections, the others have none."""
        latitude, longitude = self._corrected() if name == self._first else self._standalone[name].position()
        return {f"receiver.{name}.latitude": latitude, f"receiver.{name}.longitude": longitude}

    def _corrected(self) -> tuple[float, float]:
        noise = self._p.position_noise
        latitude, longitude = self._map.to_geodetic(
            self._car["x"] + noise * self._noise(), self._car["y"] + noise * self._noise()
        )
        return math.radians(latitude), math.radians(longitude)


IMU_QUANTITIES = "ax", "ay", "az", "yaw_rate", "roll_rate", "pitch_rate"


class _Mounting:
    """Place (m) and turn (rad) of an inertial sensor, and the names of what it reads."""

    def __init__(self, name: str, x: float, y: float, yaw: float) -> None:
        self.quantities = [f"imu.{name}.{quantity}" for quantity in IMU_QUANTITIES]
        self.x, self.y, self.cos, self.sin = x, y, math.cos(yaw), math.sin(yaw)


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
