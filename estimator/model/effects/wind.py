"""Wind: the air moves against the ground, so drag and side force depend on the heading.

What is added is the difference to still air, so that the effect vanishes without wind; the drag of still air
is `aero_drag`. With the declared drag coefficient, wind speed is what is learnt.
"""

from __future__ import annotations

import casadi as ca

from estimator.model.effect import Effect
from estimator.model.parameters import Parameter, Plausible
from estimator.model.single_track import Terms
from hil_gateway.process.arrays import Expr


def _longitudinal(terms: Terms, x: Expr, y: Expr, k_side: Expr) -> None:
    yaw, car = terms.auxiliary("yaw"), terms.vehicle
    drag = 0.5 * car.air_density * car.drag_area
    cos, sin = ca.cos(yaw), ca.sin(yaw)
    air_x = terms.vx - (x * cos + y * sin)
    air_y = terms.vy - (y * cos - x * sin)
    terms.body_x = terms.body_x - drag * (air_x * ca.fabs(air_x) - terms.vx * ca.fabs(terms.vx))
    terms.body_y = terms.body_y - k_side * (air_y - terms.vy) * terms.vx


EFFECT = Effect(
    name="wind",
    lacks="air moves against the ground",
    equation="F_x = -k (u|u| - v_x|v_x|), u = v_x - w_x; F_y = k_s w_y v_x",
    source="Milliken & Milliken, Race Car Vehicle Dynamics, ch. 3 and 15",
    parameters=(
        Parameter(
            "x",
            "m/s",
            0.0,
            5.0,
            -30.0,
            30.0,
            "velocity of the air over the ground, map x",
            Plausible(-25.0, 25.0, "a gale: nobody drives"),
        ),
        Parameter(
            "y",
            "m/s",
            0.0,
            5.0,
            -30.0,
            30.0,
            "velocity of the air over the ground, map y",
            Plausible(-25.0, 25.0, "a gale: nobody drives"),
        ),
        Parameter(
            "k_side",
            "N s2/m2",
            0.0,
            0.7,
            -3.0,
            5.0,
            "side force per forward speed and cross wind",
            Plausible(-0.5, 4.0, "rho A / 2 times the slope of the side force: 0.5 to 4; below 0 only by scatter"),
        ),
    ),
    channels=("ax", "ay", "vx_dot", "vy_dot"),
    cause="yaw",
    hooks={"LONGITUDINAL": _longitudinal},
    needs=("yaw",),
    initial=(1.0, 1.0, 0.3),
    separated_by="straights driven in opposite directions",
)
