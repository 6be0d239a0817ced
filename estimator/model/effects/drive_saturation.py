"""Drive saturation: longitudinal force saturates in slip instead of growing without bound."""

from __future__ import annotations

import casadi as ca

from estimator.model.effect import Effect
from estimator.model.parameters import Parameter, Plausible
from estimator.model.single_track import Terms
from hil_gateway.process.arrays import Expr


def _saturation(terms: Terms, force: Expr) -> None:
    terms.fx_f = force * ca.tanh(terms.fx_f / force)
    terms.fx_r = force * ca.tanh(terms.fx_r / force)


EFFECT = Effect(
    name="drive_saturation",
    lacks="longitudinal force saturates in slip",
    equation="F_x = F_max tanh(C_x d / F_max)",
    source="Pacejka, Tire and Vehicle Dynamics, ch. 4 (longitudinal force curve); tanh as its one-parameter form",
    parameters=(
        Parameter(
            "force",
            "N",
            1e7,
            1e7,
            500.0,
            1e7,
            "largest longitudinal force F_max",
            Plausible(1000.0, 40_000.0, "an axle's grip: 0.3 of the load of a light car to 2 of a heavy one's"),
        ),
    ),
    channels=("ax", "vx_dot"),
    cause="drive",
    hooks={"SATURATION": _saturation},
    initial=(9000.0,),
    on_every_car=True,
    separated_by="small and large drive commands at the same speed, both signs",
)
