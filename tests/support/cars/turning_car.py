"""A single track whose tyres saturate, integrated in small steps: other equations than the observer's."""

from __future__ import annotations

import math
import random
from collections import deque
from dataclasses import dataclass, field

from support.cars.scripted_car import reported_state

from hil_gateway.car.vehicle import Vehicle
from hil_gateway.config import Config
from hil_gateway.gateway.perceive.motion import periods_late
from hil_gateway.observer.observer import Acts, Observer
from hil_gateway.observer.steering import SteeringHypotheses

PUSHED = 1.8
"""m/s2 by the engine, most of it against drag"""
FRONT, REAR = 9.0e4, 1.3e5
"""N/rad of both axles' tyres: the car understeers"""


@dataclass
class TurningCar:
    """At a steady speed; what it reports is noisy."""

    vehicle: Vehicle
    speed: float
    grip: float = math.inf
    """of an axle over the mass that it carries, m/s2"""
    weaker: float = 1.0
    """grip of the rear axle over that of the front one"""
    stiffer: tuple[float, float] = (1.0, 1.0)
    """tyres of front and rear axle, than they are when they roll"""
    side_speed: float = 0.0
    yaw_rate: float = 0.0
    ay: float = 0.0
    _rng: random.Random = field(default_factory=lambda: random.Random(3))

    def turn(self, steer: float) -> None:
        """10 ms with this road-wheel angle, rad."""
        car = self.vehicle
        for _ in range(10):
            ahead = steer - (self.side_speed + car.lf * self.yaw_rate) / self.speed
            behind = -(self.side_speed - car.lr * self.yaw_rate) / self.speed
            front = self._force(self.stiffer[0] * FRONT * ahead, self.grip * car.lr)
            rear = self._force(self.stiffer[1] * REAR * behind, self.weaker * self.grip * car.lf)
            self.ay = (front + rear) / car.mass
            self.side_speed += 1e-3 * (self.ay - self.speed * self.yaw_rate)
            self.yaw_rate += 1e-3 * (car.lf * front - car.lr * rear) / car.yaw_inertia

    def angle(self, curvature: float) -> float:
        """Road-wheel angle with which it drives this curvature (1/m) while its tyres are far from their grip, rad."""
        car = self.vehicle
        understeer = car.mass / car.wheelbase * (car.lr / FRONT - car.lf / REAR)
        return curvature * (car.wheelbase + understeer * self.speed**2)

    def _force(self, linear: float, grip: float) -> float:
        """`grip` times the arm of the other axle, m2/s2."""
        most = grip * self.vehicle.mass / self.vehicle.wheelbase
        return linear if math.isinf(most) else most * math.tanh(linear / most)

    def reports(self) -> dict[str, float]:
        """What gyro, accelerometer and wheels say, SI."""
        draw, v, half_front = self._rng.gauss, self.speed, 0.5 * self.vehicle.track_front * self.yaw_rate
        half_rear = 0.5 * self.vehicle.track_rear * self.yaw_rate
        return {
            "yaw_rate": self.yaw_rate + draw(0, 0.0015), "ay": self.ay + draw(0, 0.11),
            "ax": PUSHED - 1.6 + draw(0, 0.11),
            "wheel_speed_fl": v - half_front + draw(0, 0.03), "wheel_speed_fr": v + half_front + draw(0, 0.03),
            "wheel_speed_rl": v - half_rear + draw(0, 0.03), "wheel_speed_rr": v + half_rear + draw(0, 0.03),
        }  # fmt: skip


class ObservedCar:
    """The observer of the declared car, which hears of such a car what it asks, reports and does."""

    def __init__(self, speed: float, grip: float = math.inf) -> None:
        config = Config()
        self.car, self.observer = TurningCar(config.vehicle, speed, grip), Observer(config)
        self.state = reported_state()
        self._late = periods_late(config.declared_car)
        self._asked: deque[float] = deque(maxlen=4 * self._late)

    def step(self, asked: float, reported: float, turned: float, *, obeys: bool = True) -> SteeringHypotheses:
        """10 ms with these road-wheel angles, rad; `reported` without the zero of its sensor, which has been learnt."""
        if not self._asked:
            self._asked.extend([asked] * 4 * self._late)
        self._asked.append(asked)
        self.car.turn(turned)
        self.state = self.state.model_copy(update=self.car.reports() | {"steer": reported})
        self.observer.step(
            self.state, self.car.speed, self.car.speed, Acts(reported, 0.0, 0.0, PUSHED), 0.0, imu=True, judges=True,
            steers=True, angles=(self._asked[-self._late], self._asked[0]) if obeys else None,
        )  # fmt: skip
        return self.observer.steering
