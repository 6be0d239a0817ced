"""Road bank: the component of gravity along body y. It moves the car, but an accelerometer does not feel it."""

from __future__ import annotations

import casadi as ca

from estimator.model.effect import Effect
from estimator.model.parameters import Parameter, Plausible, Quantity
from estimator.model.single_track import Terms
from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.process.arrays import Expr


def _input(terms: Terms, bank: Expr) -> None:
    terms.bank = bank


def _motion(terms: Terms, bank: Expr) -> None:
    terms.gravity_y = terms.gravity_y - GRAVITY * ca.sin(bank)


EFFECT = Effect(
    name="road_bank",
    lacks="gravity component along body y as a function of track position",
    equation="dv_y/dt += -g sin(phi(s)), phi(s) a periodic cubic spline",
    source="Rajamani, Vehicle Dynamics and Control, eq. 2.40",
    parameters=(
        Parameter(
            "bank",
            "rad",
            0.0,
            0.05,
            -0.6,
            0.6,
            "left side up positive, over track position",
            Plausible(-0.58, 0.58, "the steepest speedways are banked by 33 deg"),
            quantity=Quantity.BANK,
        ),
    ),
    channels=("vy_dot",),
    judged_by=("ay", "yaw_acc", "vy_dot"),
    cause="track_position",
    hooks={"INPUT": _input, "MOTION": _motion},
    needs=("track_position",),
    profile="track_position",
    separated_by="shows in d/dt vy and not in ay; a force on the body shows in both",
)
