"""Traction loss: longitudinal force falls with lateral force on the same axle, the other half of combined slip."""

from __future__ import annotations

from estimator.model.effect import Effect, friction_left
from estimator.model.parameters import Parameter, Plausible, Quantity
from estimator.model.single_track import Terms
from hil_gateway.process.arrays import Expr


def _force(terms: Terms, k: Expr) -> None:
    terms.fx_f = terms.fx_f * friction_left(k, terms.fy_f, terms.peak_f)
    terms.fx_r = terms.fx_r * friction_left(k, terms.fy_r, terms.peak_r)


EFFECT = Effect(
    name="traction_loss",
    lacks="longitudinal force at a given slip falls with lateral force on the same axle",
    equation="F_x = F_x0 sqrt(1 - (k F_y / (D F_z))^2)",
    source="Pacejka, Tire and Vehicle Dynamics, ch. 1.2 (friction ellipse)",
    parameters=(
        Parameter(
            "k",
            "1",
            0.0,
            0.7,
            0.0,
            1.5,
            "share of the friction ellipse that counts; 1: all of it",
            Plausible(0.0, 1.4, "friction circle 1; tyres are within half of it"),
            quantity=Quantity.TRACTION_ELLIPSE,
        ),
    ),
    channels=("ax", "vx_dot"),
    cause="ay",
    hooks={"FORCE": _force},
    initial=(0.6,),
    on_every_car=True,
    separated_by="the same slip command on straights and in corners",
)
