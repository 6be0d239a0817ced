"""Traction load: the driven axle's longitudinal force at a given slip grows with its load, as the lateral one does.

`load_transfer` uses the force before this gain: the one after it depends on the load it moves.
"""

from __future__ import annotations

from estimator.model.effect import Effect
from estimator.model.parameters import Parameter, Plausible, Quantity
from estimator.model.single_track import Terms
from hil_gateway.process.arrays import Expr


def _grip(terms: Terms, share: Expr) -> None:
    terms.fx_r = terms.fx_r * (1.0 + share * (terms.load_r / terms.vehicle.static_load_rear - 1.0))


EFFECT = Effect(
    name="traction_load",
    lacks="longitudinal force at a given slip grows with the driven axle's load",
    equation="F_x,r = C_x d (1 + k (F_z,r / F_z0,r - 1))",
    source="Pacejka, Tire and Vehicle Dynamics, eq. 4.E15 (K_xk in proportion to F_z)",
    parameters=(
        Parameter(
            "share",
            "1",
            0.0,
            0.5,
            0.0,
            3.0,
            "relative gain of C_x per relative gain of load",
            Plausible(
                0.0, 2.0, "1 in proportion to the load; more where K_xk / F_z grows with it: positive p_Kx2, p_Kx3"
            ),
        ),
    ),
    channels=("ax", "vx_dot"),
    cause="vx",
    hooks={"GRIP": _grip},
    requires_any=(Quantity.DOWNFORCE, Quantity.CG_HEIGHT, Quantity.BANK),
    on_every_car=True,
    separated_by="the same slip command at very different speeds, or on and off a bank",
)
