"""Torque vectoring: as the driven axle pushes it turns the car into the bend; a differential that locks resists."""

from __future__ import annotations

from estimator.model.effect import Effect, braking_force, smooth_sign
from estimator.model.effects.yaw_damping import EFFECT as YAW_DAMPING
from estimator.model.parameters import Parameter, Plausible
from estimator.model.single_track import Terms
from hil_gateway.process.arrays import Expr

STRAIGHT = 0.01
"""rad; the moment fades at smaller road-wheel angles"""


def _body(terms: Terms, lever: Expr) -> None:
    pushing = terms.fx_r - braking_force(terms.fx_r, terms.vehicle)
    terms.body_yaw = terms.body_yaw + lever * pushing * smooth_sign(terms.steer, STRAIGHT)


TORQUE_VECTORING = Effect(
    name="torque_vectoring",
    form_of=YAW_DAMPING,
    lacks="the driven axle turns the car into the bend",
    equation="M_z = k max(F_x,r, 0) sign(delta)",
    source="Milliken & Milliken, Race Car Vehicle Dynamics, ch. 20 (differentials)",
    parameters=(
        Parameter(
            "lever",
            "m",
            0.0,
            0.1,
            -1.5,
            1.5,
            "moment per driving force",
            Plausible(
                0.0, 0.8, "half the track: all of the force on one wheel; out of the bend, an axle that locks", 0.02
            ),
        ),
    ),
    channels=("yaw_acc",),
    cause="drive",
    hooks={"BODY": _body},
    separated_by="power on and off in the same corner",
)
