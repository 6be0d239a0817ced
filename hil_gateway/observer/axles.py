"""Both axles in numbers of now, and which steering angle turns the car as wanted.

The angle acts later: the car goes on as `lateral` has it under what was asked for before and is not answered yet
(O. J. M. Smith, Chemical Engineering Progress 53, 1957). From there the front tyres make the force that changes the yaw
rate, at the slip angle that makes it, beside where the front axle goes: an angle that follows the car into a slide
(R. Y. Hindiyeh and J. C. Gerdes, ASME J. Dynamic Systems, Measurement, and Control 136, 2014).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, Self

from hil_gateway.car.vehicle import Vehicle
from hil_gateway.observer import lateral
from hil_gateway.observer.lateral import LateralPeriod, Turning, left_of_both
from hil_gateway.observer.numbers import Given, Sensing
from hil_gateway.settings.gateway import PERIOD_S


class Axle(NamedTuple):
    """Specific force over slip angle, m/s2 of the whole car were the other axle like it."""

    most: float
    """m/s2 that engine and brakes leave of it"""
    slope: float
    """rad"""
    error: float
    """m/s2 that it makes beyond that, whatever its tyres are"""

    def force(self, angle: float) -> float:
        """At a slip angle, rad."""
        return self.most * math.tanh(angle / self.slope) + self.error

    def angle(self, force: float) -> float:
        """Slip angle (rad) at which it makes a force (m/s2), or nearly all that it makes."""
        share = (force - self.error) / self.most
        return self.slope * math.atanh(max(-NEARLY, min(share, NEARLY)))


NEARLY = math.sqrt(1.0 - lateral.NOISE.least_left**2)
"""of the most: where hardly any grip is left along, as `lateral` has it, more takes ever larger angles"""


class Axles(NamedTuple):
    """As the observer knows them, SI; see `lateral`."""

    car: Vehicle
    front: Axle
    rear: Axle
    speed: float
    side_speed: float
    yaw_rate: float
    zero: float
    """road-wheel angle by which the tyres turn beyond the one that is asked for, rad"""
    gravity_across: float
    turned: float = 0.0
    """rad by which the car has turned on its last way `onward`"""

    def onward(self, angles: Sequence[float]) -> Self:
        """After so many periods under these road-wheel angles, rad."""
        car, side, rate, turned = self.car, self.side_speed, self.yaw_rate, 0.0
        for angle in angles:
            front = self.front.force(angle + self.zero - self._front_goes(side, rate))
            rear = self.rear.force(self._rear_slips(side, rate))
            across = (car.lr * front + car.lf * rear) / car.wheelbase
            side += PERIOD_S * (across - self.speed * rate - self.gravity_across)
            rate += PERIOD_S * self._turns * (front - rear)
            turned += PERIOD_S * rate
        return self._replace(side_speed=side, yaw_rate=rate, turned=turned)

    def steered(self, turning: float) -> float:
        """Road-wheel angle to ask for, rad, so that the yaw rate changes by `turning`, rad/s2."""
        rear = self.rear.force(self._rear_slips(self.side_speed, self.yaw_rate))
        goes = self._front_goes(self.side_speed, self.yaw_rate)
        return goes - self.zero + self.front.angle(rear + turning / self._turns)

    def rear_goes(self, curvature: float) -> float:
        """Direction in which the rear axle goes on a path of this curvature (1/m), rad to the left of the car."""
        return -self.rear.angle(self.speed**2 * curvature + self.gravity_across)

    @property
    def _turns(self) -> float:
        """Yaw acceleration over the difference of both forces, 1/m."""
        car = self.car
        return car.mass * car.lf * car.lr / (car.wheelbase * car.yaw_inertia)

    def _front_goes(self, side: float, rate: float) -> float:
        """Direction in which the front axle goes, rad to the left of the car."""
        return (side + self.car.lf * rate) / self.speed

    def _rear_slips(self, side: float, rate: float) -> float:
        return -(side - self.car.lr * rate) / self.speed


def axles(car: Vehicle, fades: float, x: Sequence[float], period: LateralPeriod) -> Axles:
    """From `lateral.STATES` and what was reported in the same period; `fades`: friction lost with load."""
    model = Turning(Given(None, [], car, Sensing(*[0.0] * len(Sensing._fields)), fades, []), period)
    states = (lateral.SF, lateral.SR), (lateral.EF, lateral.ER)
    front, rear = (
        Axle(limit * left_of_both(lean, used), x[slope], limit * x[error])
        for limit, lean, used, slope, error in zip(model.limits(x), model.leans(x), model.used(x), *states, strict=True)
    )
    across = period.gravity_across + x[lateral.GB]
    return Axles(car, front, rear, period.speed, x[lateral.VY], x[lateral.R], x[lateral.ZERO], across)
