"""Combined slip: lateral force falls with longitudinal force on the same axle (friction ellipse)."""

from __future__ import annotations

from estimator.model.effects.base import Effect, friction_left
from estimator.model.parameters import Parameter, Plausible
from estimator.model.single_track import Terms
from hil_gateway.process.arrays import Expr


def _force(terms: Terms, k: Expr) -> None:
    terms.left_f = friction_left(k, terms.fx_f, terms.peak_f)
    terms.left_r = friction_left(k, terms.fx_r, terms.peak_r)
    terms.fy_f, terms.fy_r = terms.left_f * terms.fy_f, terms.left_r * terms.fy_r


EFFECT = Effect(
    name="combined_slip",
    lacks="lateral force falls with longitudinal force on the same axle",
    equation="F_y = F_y0 sqrt(1 - (k F_x / (D F_z))^2)",
    source="Pacejka, Tire and Vehicle Dynamics, ch. 1.2 (friction ellipse)",
    parameters=(
        Parameter(
            "k",
            "1",
            0.0,
            0.7,
            0.0,
            2.0,
            "lateral over longitudinal friction; 1: friction circle",
            Plausible(0.0, 1.6, "friction circle 1; tyres are within half of it"),
        ),
    ),
    channels=("ay", "yaw_acc", "vy_dot"),
    cause="drive",
    hooks={"FORCE": _force},
    initial=(0.6,),
    separated_by="braking and accelerating in the same corner (load transfer changes sign between them)",
    on_every_car=True,
)
