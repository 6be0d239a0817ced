"""Limited slip: clutches of the driven axle's differential move force from the outer, faster wheel to the inner one.

Second form of `yaw_damping`: below what the clutches bear the axle turns as if locked, and its moment falls with speed;
beyond it they slip, and the moment goes with the force of the driven axle.
"""

from __future__ import annotations

import casadi as ca

from can_dbc.units import UNITS
from estimator.model.effect import NOT_DRIVEN_WITH, Effect
from estimator.model.effects.yaw_damping import EFFECT as YAW_DAMPING
from estimator.model.parameters import Parameter, Plausible
from estimator.model.single_track import Terms
from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.process.arrays import Expr

PRELOAD = 0.13
"""of the weight; longitudinal force that presses the clutches as their springs do"""
STRAIGHT = 0.02
"""rad/s; below it the moment fades, as the wheels' speeds hardly differ"""


def _body(terms: Terms, lever: Expr, compliance: Expr) -> None:
    preload = PRELOAD * GRAVITY * terms.vehicle.mass
    most = lever * ca.sqrt(terms.fx_r * terms.fx_r + preload * preload)
    slipping_from = compliance * terms.vx * most / UNITS["kN"].factor
    omega = terms.yaw_rate
    terms.body_yaw = terms.body_yaw - most * omega / ca.sqrt(
        omega * omega + slipping_from * slipping_from + STRAIGHT * STRAIGHT
    )


EFFECT = Effect(
    name="limited_slip",
    lacks="the driven axle's torque locks its wheels",
    equation="M_z = -M omega / sqrt(omega^2 + (c v_x M)^2), M = k sqrt(F_x,r^2 + F_0^2), F_0 = 0.13 m g",
    source="Milliken & Milliken, Race Car Vehicle Dynamics, ch. 20 (torque-sensitive differentials)",
    parameters=(
        Parameter(
            "lever",
            "m",
            0.0,
            0.2,
            0.0,
            1.5,
            "moment that the clutches bear per longitudinal force of the driven axle",
            Plausible(0.0, 0.8, "the locked share of the torque times half the track: 0.8 with all of it", 0.02),
        ),
        Parameter(
            "compliance",
            "rad/(kN m2)",
            0.0,
            0.03,
            0.0,
            0.5,
            "yaw rate over speed and moment while the axle is locked; 0: its clutches always slip",
            Plausible(0.0, 0.1, "4 / (C_x track^2): 0.015 with 120 kN and 1.5 m, more with softer tyres"),
        ),
    ),
    channels=("yaw_acc",),
    cause="drive",
    hooks={"BODY": _body},
    initial=(0.2, 0.015),
    form_of=YAW_DAMPING,
    unsought_while_driving=NOT_DRIVEN_WITH,
    separated_by="power and braking in the same corner: load transfer changes sign with the force, this does not",
    on_every_car=True,
)
