"""Steering scale: the reported road-wheel angle is off by a factor.

It is not told from a sensor of vy at x ahead of the centre of gravity: the kinematic angle L omega / vx looks larger by
x / L, and what both axles then lack of slip their tyres make up for.
"""

from __future__ import annotations

from estimator.model.effect import VY_SENSOR, Effect
from estimator.model.parameters import Parameter, Plausible
from estimator.model.single_track import Terms
from hil_gateway.process.arrays import Expr


def _input(terms: Terms, scale: Expr) -> None:
    terms.steer = scale * terms.steer


EFFECT = Effect(
    name="steer_scale",
    lacks="true road-wheel angle differs from the reported one by a factor",
    equation="delta = k delta_reported",
    source="definition",
    parameters=(
        Parameter(
            "scale",
            "1",
            1.0,
            0.1,
            0.3,
            3.0,
            "true over reported angle",
            Plausible(
                0.7, 1.4, "another steering ratio in the same family of cars; racks and joints give 1 to 2 %", 0.02
            ),
        ),
    ),
    channels=("ay", "yaw_acc", "vy_dot"),
    cause="steer",
    hooks={"INPUT": _input},
    constant_at="steer_gain",
    hidden_by=VY_SENSOR,
    separated_by="tight slow corners, where the kinematic part of the angle is large against the slip",
)
