"""A car moved by hand on the road of a track, and what its sensors say: rigid kinematics, no tyre or engine model.

The wheels roll; across a slope they creep downhill by a share of their way, as tyres under a side force do. Nothing of
it comes from the estimator or from the plant.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import cos, pi, sin, tan
from typing import Any

import numpy as np

from hil_gateway.bus.messages import VehicleState
from hil_gateway.car.car import load_car
from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.track.track import Track

DT = 0.01
FIX_EVERY = 5
CREEP = 0.006
"""slip angle of the rear axle a m/s2 of side force, rad"""
JERK = 2.0
"""m/s2 a second: people"""
PUSH = 0.6
"""m/s2"""
VEHICLE = load_car().vehicle


@dataclass(frozen=True)
class Errors:
    """Of the sensors, SI; `wander` m per square root of a second, `drift` m/s along `drift_yaw`."""

    ax: float = 0.15
    ay: float = -0.12
    yaw_rate: float = 0.004
    wander: float = 0.04
    drift: float = 0.0
    drift_yaw: float = 0.0
    steer: float = 0.003
    wheel_step: float = 0.1 / 3.6
    """resolution of the wheel speeds, and"""
    wheel_least: float = 0.0
    """below what they say 0, m/s"""


class PushedCar:
    """`state` once every `DT`; speed follows `speed(t)` (m/s, negative: backwards) as people push."""

    def __init__(  # noqa: PLR0917 - a place, a direction, a push
        self, track: Track, s: float, turned: float = 0.0, errors: Errors | None = None, seed: int = 0,
        speed: Callable[[float], float] = lambda t: 0.0, steer: Callable[[float], float] = lambda t: 0.0,
    ) -> None:  # fmt: skip
        point = track.at(s)
        self.track, self.errors, self.speed, self.steer = track, errors or Errors(), speed, steer
        self.x, self.y, self.yaw, self.s = float(point.x), float(point.y), float(point.heading) + turned, s
        self.vx = self.vy = self.yaw_rate = self.rolled = 0.0
        self.k = self.fixes = 0
        self._accel = 0.0
        self._rng = np.random.default_rng(seed)
        self._wander = np.zeros(2)
        self._fix = (self.x, self.y)

    @property
    def t(self) -> float:
        return self.k * DT

    def state(self) -> VehicleState:
        """The next sample."""
        force = self._move()
        e, noise = self.errors, self._rng.normal(size=8)
        wheels = [self._wheel(abs(self.vx) + 0.03 * n * (abs(self.vx) > 0.1)) for n in noise[:4]]
        values: dict[str, Any] = {
            "ax": force[0] + e.ax + 0.11 * noise[4], "ay": force[1] + e.ay + 0.11 * noise[5], "az": GRAVITY,
            "yaw_rate": self.yaw_rate + e.yaw_rate + 0.0015 * noise[6], "steer": self.steer(self.t) - e.steer,
            "drive": 0.0,
        }  # fmt: skip
        values |= dict(zip((f"wheel_speed_{w}" for w in ("fl", "fr", "rl", "rr")), wheels, strict=True))
        zero = ("steer_rate", "accelerator", "throttle", "brake_front", "brake_rear", "engine_speed", "roll_rate")
        values |= dict.fromkeys(zero, 0.0)
        values |= dict.fromkeys(("gear", "sys_state", "ct_state", "track_flag", "vehicle_flag"), 1)
        self._receive()
        x, y = self._fix
        return VehicleState(
            stamp_ns=1_000_000_000 + round(self.k * DT * 1e9), seq=self.k, valid=True, sources={},
            position_x=x, position_y=y, position_seq=self.fixes, **values,
        )  # fmt: skip

    def states(self, seconds: float) -> Iterator[VehicleState]:
        """Those of so many seconds."""
        for _ in range(round(seconds / DT)):
            yield self.state()

    def _move(self) -> tuple[float, float]:
        """One sample on; the specific force over it, m/s2."""
        self.k += 1
        before = self.vx, self.vy, self.yaw_rate
        wanted = max(-PUSH, min((self.speed(self.t) - self.vx) / 0.3, PUSH))
        self._accel += max(-JERK * DT, min(wanted - self._accel, JERK * DT))
        self.vx += self._accel * DT
        if self.speed(self.t) == 0.0 and abs(self.vx) < 0.01:
            self.vx = self._accel = 0.0
        gravity = self._gravity()
        self.yaw_rate = self.vx * tan(self.steer(self.t)) / VEHICLE.wheelbase
        self.vy = VEHICLE.lr * self.yaw_rate + CREEP * gravity[1] * abs(self.vx)
        vx, vy, rate = (0.5 * (a + b) for a, b in zip(before, (self.vx, self.vy, self.yaw_rate), strict=True))
        middle = self.yaw + 0.5 * rate * DT
        self.x += DT * (vx * cos(middle) - vy * sin(middle))
        self.y += DT * (vx * sin(middle) + vy * cos(middle))
        self.yaw += rate * DT
        self.rolled += abs(vx) * DT
        return (
            (self.vx - before[0]) / DT - vy * rate - gravity[0],
            (self.vy - before[1]) / DT + vx * rate - gravity[1],
        )

    def _gravity(self) -> tuple[float, float]:
        self.s, _ = self.track.project(self.x, self.y, self.s)
        point = self.track.at(self.s)
        along, left = -GRAVITY * sin(point.grade), -GRAVITY * sin(point.bank)
        c, s = cos(self.yaw - point.heading), sin(self.yaw - point.heading)
        return along * c + left * s, left * c - along * s

    def _wheel(self, speed: float) -> float:
        e = self.errors
        return 0.0 if speed < e.wheel_least else round(abs(speed) / e.wheel_step) * e.wheel_step

    def _receive(self) -> None:
        e = self.errors
        if self.k % FIX_EVERY != 1:
            return
        self.fixes += 1
        self._wander += self._rng.normal(0.0, e.wander * (FIX_EVERY * DT) ** 0.5, 2)
        noise = self._rng.normal(0.0, 0.02, 2)
        place = self.place
        self._fix = float(place[0] + noise[0]), float(place[1] + noise[1])

    @property
    def place(self) -> tuple[float, float]:
        """Where the receiver has the car, but for the noise of a fix, m."""
        e, drift = self.errors, self.errors.drift * self.t
        x, y = self._wander.tolist()
        return self.x + x + drift * cos(e.drift_yaw), self.y + y + drift * sin(e.drift_yaw)

    def heading_error(self, yaw: float) -> float:
        """Of an estimate, rad."""
        return (yaw - self.yaw + pi) % (2 * pi) - pi
