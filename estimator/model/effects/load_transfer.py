"""Longitudinal load transfer: axle loads move with longitudinal acceleration.

The acceleration is the one the longitudinal forces give, (F_x,f + F_x,r + F_x,body) / m. The small part
-F_y,f sin(delta) is left out: it depends on the load, and would close an algebraic loop.

The height is the one that explains what the tyres do at once: tyres that lose a share k of D as their load doubles make
(1 - k) of the moved load, and loads that follow the acceleration late move less.
"""

from __future__ import annotations

from estimator.model.effects.base import Effect
from estimator.model.parameters import Parameter, Plausible
from estimator.model.single_track import Terms
from hil_gateway.process.arrays import Expr


def _load(terms: Terms, height: Expr) -> None:
    moved = height / terms.vehicle.wheelbase * (terms.fx_f + terms.fx_r + terms.body_x)
    terms.load_f = terms.load_f - moved
    terms.load_r = terms.load_r + moved


EFFECT = Effect(
    name="load_transfer",
    lacks="axle loads move with longitudinal acceleration",
    equation="F_z,f = F_z0,f - h m a_x / L; F_z,r = F_z0,r + h m a_x / L, h the effective height: "
    "less than the true one as tyres lose D with load and loads follow late",
    source="Gillespie, Fundamentals of Vehicle Dynamics, eq. 1.7",
    parameters=(
        Parameter(
            "height",
            "m",
            0.0,
            0.2,
            0.0,
            1.5,
            "effective height of the centre of gravity: 0.55 to 0.9 of the true one on real tyres",
            Plausible(0.0, 0.6, "race cars 0.25 to 0.4, road cars 0.5 to 0.6"),
        ),
    ),
    channels=("ay", "yaw_acc", "vy_dot"),
    cause="drive",
    hooks={"LOAD": _load},
    separated_by="braking and accelerating in the same corner (combined slip acts alike for both signs of force)",
    on_every_car=True,
)
