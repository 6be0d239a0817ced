"""Combined slip: lateral force falls with longitudinal force on the same axle (friction ellipse)."""

from __future__ import annotations

from estimator.model.effect import DeclaredParameter, Effect, friction_left
from estimator.model.parameters import Parameter, Plausible, Quantity
from estimator.model.single_track import Terms
from hil_gateway.car.car import Car
from hil_gateway.process.arrays import Expr


def _declare(car: Car) -> tuple[DeclaredParameter, ...]:
    """By similarity (Pacejka, ch. 3.3) a longitudinal force of half the peak takes 3 % of the lateral force at small
    slip angles and one of 0.9 takes 30 %, as ellipses with 0.5 and 0.8 do; at the peak they have 0.95. Without it what
    an axle loses under power or brakes passes for load transfer that is not there."""
    return (DeclaredParameter(car.tyres.combined_slip, car.std("tyres.combined_slip")),)


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
            quantity=Quantity.FRICTION_ELLIPSE,
        ),
    ),
    channels=("ay", "yaw_acc", "vy_dot"),
    cause="drive",
    hooks={"FORCE": _force},
    initial=(0.6,),
    separated_by="braking and accelerating in the same corner (load transfer changes sign between them)",
    on_every_car=True,
    fitted_with_tyres="forces",
    declare=_declare,
)
