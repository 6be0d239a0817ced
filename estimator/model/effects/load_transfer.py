"""Longitudinal load transfer: axle loads move with longitudinal acceleration.

The acceleration is the one the longitudinal forces give, (F_x,f + F_x,r + F_x,body) / m. The small part
-F_y,f sin(delta) is left out: it depends on the load, and would close an algebraic loop.

The height is the one that explains what the tyres do at once: tyres that lose a share k of D as their load doubles make
(1 - k) of the moved load, and loads that follow the acceleration late move less.
"""

from __future__ import annotations

from dataclasses import replace

from estimator.model.effect import DeclaredParameter, Effect
from estimator.model.parameters import Parameter, Plausible, Quantity
from estimator.model.single_track import Terms
from hil_gateway.car.car import Car
from hil_gateway.process.arrays import Expr


def _declare(car: Car) -> tuple[DeclaredParameter, ...]:
    return (DeclaredParameter(car.vehicle.cg_height, car.std("vehicle.cg_height")),)


def _load(terms: Terms, height: Expr) -> None:
    moved = height / terms.vehicle.wheelbase * (terms.fx_f + terms.fx_r + terms.body_x)
    terms.load_f = terms.load_f - moved
    terms.load_r = terms.load_r + moved


def _load_by_ax(terms: Terms, height: Expr) -> None:
    moved = height / terms.vehicle.wheelbase * terms.vehicle.mass * terms.aux["ax"]
    terms.load_f = terms.load_f - moved
    terms.load_r = terms.load_r + moved


_BY_FORCES = Effect(
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
            quantity=Quantity.CG_HEIGHT,
        ),
    ),
    channels=("ay", "yaw_acc", "vy_dot"),
    cause="drive",
    hooks={"LOAD": _load},
    separated_by="braking and accelerating in the same corner (combined slip acts alike for both signs of force)",
    on_every_car=True,
    fitted_with_tyres="loads",
    declare=_declare,
)
_BY_AX = replace(
    _BY_FORCES,
    equation="F_z,f = F_z0,f - h m a_x / L; F_z,r = F_z0,r + h m a_x / L, a_x as logged or derived",
    hooks={"LOAD": _load_by_ax},
    needs=("ax",),
)
"""The ax of a log has brakes and slopes in it, which the model's forces lack."""

EFFECT = replace(_BY_FORCES, as_logged=_BY_AX)
