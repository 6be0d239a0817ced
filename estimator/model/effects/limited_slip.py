"""Limited slip: clutches of the driven axle's differential move force from the outer, faster wheel to the inner one.

Second form of `yaw_damping`: below what the clutches bear the axle turns as if locked, and its moment falls with speed;
beyond it they slip, and the moment goes with the force of the driven axle.
"""

from __future__ import annotations

import casadi as ca

from estimator.model.effects.base import Effect
from estimator.model.parameters import Parameter, Plausible
from estimator.model.single_track import Terms
from hil_gateway.process.arrays import Expr

PRELOAD = 1000.0
"""N; longitudinal force that presses the clutches as their springs do"""
SLOWEST = 1.0
"""m/s; keeps the moment of a locked axle at rest finite"""
SMALLEST_MOMENT = 1.0
"""N m; keeps the root differentiable"""


def _body(terms: Terms, lever: Expr, stiffness: Expr) -> None:
    locked = stiffness * terms.yaw_rate / ca.sqrt(terms.vx * terms.vx + SLOWEST * SLOWEST)
    most = lever * ca.sqrt(terms.fx_r * terms.fx_r + PRELOAD * PRELOAD)
    terms.body_yaw = terms.body_yaw - locked * most / ca.sqrt(most * most + locked * locked + SMALLEST_MOMENT**2)


EFFECT = Effect(
    name="limited_slip",
    lacks="the driven axle's torque locks its wheels",
    equation="M_z = -M_l M_m / sqrt(M_l^2 + M_m^2), M_l = S omega / v_x, M_m = k sqrt(F_x,r^2 + F_0^2), F_0 = 1 kN",
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
            "stiffness",
            "N m2/rad",
            0.0,
            3e4,
            0.0,
            4e5,
            "moment of the locked axle per yaw rate, times speed",
            Plausible(0.0, 3e5, "C_x track^2 / 4: 70 kN m2 with 120 kN and 1.5 m; stiff tyres four times that"),
        ),
    ),
    channels=("yaw_acc",),
    cause="drive",
    hooks={"BODY": _body},
    initial=(0.2, 6e4),
    form_of="yaw_damping",
    separated_by="power and braking in the same corner: load transfer changes sign with the force, this does not",
    on_every_car=True,
)
