"""Steering offset: the reported road-wheel angle is off by a constant."""

from __future__ import annotations

from estimator.model.effect import DeclaredParameter, Effect
from estimator.model.parameters import Parameter, Plausible, Quantity
from estimator.model.single_track import Terms
from hil_gateway.car.car import Car
from hil_gateway.process.arrays import Expr


def _declare(car: Car) -> tuple[DeclaredParameter, ...]:
    true_less_reported = 0.0 - car.sensors.steering_offset / car.vehicle.steering_ratio
    return (DeclaredParameter(true_less_reported, car.std("sensors.steering_offset") / car.vehicle.steering_ratio),)


def _input(terms: Terms, offset: Expr) -> None:
    terms.steer = terms.steer + offset


EFFECT = Effect(
    name="steer_offset",
    lacks="true road-wheel angle differs from the reported one by a constant",
    equation="delta = delta_reported + delta_0",
    source="definition",
    parameters=(
        Parameter(
            "offset",
            "rad",
            0.0,
            0.01,
            -0.1,
            0.1,
            "true minus reported angle",
            Plausible(-0.06, 0.06, "a zero more than 3.5 deg off is a broken sensor"),
            quantity=Quantity.STEER_ZERO,
        ),
    ),
    channels=("ay", "yaw_acc", "vy_dot"),
    cause="steer",
    hooks={"INPUT": _input},
    constant_at="steer",
    separated_by="straight driving; a lateral accelerometer bias does not show in the yaw acceleration",
    declare=_declare,
)
