"""Turn asymmetry: tyres give more force in left than in right turns (stagger, camber, cross-weight)."""

from __future__ import annotations

from estimator.model.effect import Effect, smooth_sign
from estimator.model.parameters import Parameter, Plausible
from estimator.model.single_track import Terms
from hil_gateway.process.arrays import Expr

SMOOTHING_SLIP = 0.002
"""The change from left to right is smooth within about this slip angle, rad."""


def _grip(terms: Terms, k: Expr) -> None:
    terms.grip_f = terms.grip_f * (1.0 + k * smooth_sign(terms.slip_f, SMOOTHING_SLIP))
    terms.grip_r = terms.grip_r * (1.0 + k * smooth_sign(terms.slip_r, SMOOTHING_SLIP))


EFFECT = Effect(
    name="turn_asymmetry",
    lacks="left and right turns differ (stagger, camber, cross-weight)",
    equation="D_i = D_0,i (1 + k sign(alpha_i))",
    source="Milliken & Milliken, Race Car Vehicle Dynamics, ch. 19 (oval set-up)",
    parameters=(
        Parameter(
            "k",
            "1",
            0.0,
            0.1,
            -0.8,
            0.8,
            "half the relative difference of D, left minus right",
            Plausible(-0.4, 0.4, "an oval set-up is less than 20 % apart"),
        ),
    ),
    channels=("ay", "yaw_acc", "vy_dot"),
    cause="ay",
    hooks={"GRIP": _grip},
    separated_by="left and right turns of like radius and speed; an offset of the angle shows on straights too",
)
