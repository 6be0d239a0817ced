"""Load sensitivity: the friction coefficient D falls as the axle load rises."""

from __future__ import annotations

from estimator.model.effect import DeclaredParameter, Effect
from estimator.model.parameters import Parameter, Plausible, Quantity
from estimator.model.single_track import Terms
from hil_gateway.car.car import Car
from hil_gateway.process.arrays import Expr


def _declare(car: Car) -> tuple[DeclaredParameter, ...]:
    return (DeclaredParameter(car.tyres.load_sensitivity, car.std("tyres.load_sensitivity")),)


def _grip(terms: Terms, k: Expr) -> None:
    v = terms.vehicle
    terms.grip_f = terms.grip_f * (1.0 - k * (terms.load_f / v.static_load_front - 1.0))
    terms.grip_r = terms.grip_r * (1.0 - k * (terms.load_r / v.static_load_rear - 1.0))


EFFECT = Effect(
    name="load_sensitivity",
    lacks="D falls with axle load",
    equation="D_i = D_0,i (1 - k (F_z,i / F_z0,i - 1))",
    source="Pacejka, Tire and Vehicle Dynamics, eq. 4.E19 (coefficient p_Dy2)",
    parameters=(
        Parameter(
            "k",
            "1",
            0.0,
            0.3,
            0.0,
            1.5,
            "relative loss of D per relative gain of load",
            Plausible(0.0, 0.8, "race tyres lose 5 to 40 % of D as the load doubles"),
        ),
    ),
    channels=("ay", "yaw_acc", "vy_dot"),
    cause="vx",
    hooks={"GRIP": _grip},
    requires_any=(Quantity.DOWNFORCE, Quantity.CG_HEIGHT, Quantity.BANK),
    declare=_declare,
    separated_by="with static loads it cannot show; needs downforce or load transfer over a wide range of loads",
)
