"""Rolling resistance: constant force against the motion."""

from __future__ import annotations

from estimator.model.effect import Effect, smooth_sign
from estimator.model.parameters import Parameter, Plausible
from estimator.model.single_track import Terms
from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.process.arrays import Expr

STANDSTILL = 0.093
"""Speed over the root of gravity times wheelbase below about which the force fades instead of chattering about zero:
0.5 m/s for an AV-24."""


def _longitudinal(terms: Terms, force: Expr) -> None:
    terms.body_x = terms.body_x - force * smooth_sign(terms.vx, STANDSTILL * GRAVITY * terms.vehicle.own_time)


EFFECT = Effect(
    name="rolling_resistance",
    lacks="constant force against vx",
    equation="F_x = -F_0 sign(v_x)",
    source="Gillespie, Fundamentals of Vehicle Dynamics, ch. 4",
    parameters=(
        Parameter(
            "force",
            "N",
            0.0,
            300.0,
            0.0,
            3000.0,
            "force against the motion",
            Plausible(
                0.0,
                800.0,
                "race tyres on asphalt: 1 to 3 % of the load, dragging brakes and bearings as much: 6 % of 13 kN",
            ),
        ),
    ),
    channels=("ax", "vx_dot"),
    cause="vx",
    hooks={"LONGITUDINAL": _longitudinal},
    separated_by="an accelerometer bias shows in ax but not in d/dt vx; engine braking only with the throttle closed",
    on_every_car=True,
    constant_at="force_x",
)
