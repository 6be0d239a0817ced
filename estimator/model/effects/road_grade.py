"""Road grade: the component of gravity along body x. It moves the car, but an accelerometer does not feel it."""

from __future__ import annotations

import casadi as ca

from estimator.model.effect import Effect
from estimator.model.parameters import Parameter, Plausible, Quantity
from estimator.model.single_track import Terms
from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.process.arrays import Expr


def _motion(terms: Terms, grade: Expr) -> None:
    terms.gravity_x = terms.gravity_x - GRAVITY * ca.sin(grade)


EFFECT = Effect(
    name="road_grade",
    lacks="gravity component along body x as a function of track position",
    equation="dv_x/dt += -g sin(theta(s)), theta(s) a periodic cubic spline",
    source="Rajamani, Vehicle Dynamics and Control, eq. 4.1",
    parameters=(
        Parameter(
            "grade",
            "rad",
            0.0,
            0.05,
            -0.6,
            0.6,
            "uphill positive, over track position",
            Plausible(-0.3, 0.3, "the steepest race tracks: 0.18"),
            quantity=Quantity.GRADE,
        ),
    ),
    channels=("vx_dot",),
    judged_by=("ax", "vx_dot"),
    cause="track_position",
    hooks={"MOTION": _motion},
    needs=("track_position",),
    profile="track_position",
    separated_by="shows in d/dt vx and not in ax; a force on the body shows in both",
)
