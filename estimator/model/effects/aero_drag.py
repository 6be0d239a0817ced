"""Aerodynamic drag: force against the motion through the air, F = -k v|v|."""

from __future__ import annotations

import casadi as ca

from estimator.model.effect import DeclaredParameter, Effect
from estimator.model.parameters import Parameter, Plausible
from estimator.model.single_track import Terms
from hil_gateway.car.car import Car
from hil_gateway.process.arrays import Expr


def _declare(car: Car) -> tuple[DeclaredParameter, ...]:
    pressed = 0.5 * car.vehicle.air_density
    return (DeclaredParameter(pressed * car.vehicle.drag_area, pressed * car.std("vehicle.drag_area")),)


def _longitudinal(terms: Terms, k: Expr) -> None:
    terms.body_x = terms.body_x - k * terms.vx * ca.fabs(terms.vx)


EFFECT = Effect(
    name="aero_drag",
    lacks="force against vx that grows with the square of speed",
    equation="F_x = -k v_x |v_x|",
    source="Milliken & Milliken, Race Car Vehicle Dynamics, ch. 3",
    parameters=(
        Parameter(
            "k",
            "N s2/m2",
            0.0,
            1.0,
            0.0,
            5.0,
            "rho Cd A / 2",
            Plausible(0.0, 3.0, "open-wheel cars and lorries' cabs: rho Cd A / 2 of 0.4 to 2; any body has 0.02", 0.02),
        ),
    ),
    channels=("ax", "vx_dot"),
    cause="vx",
    hooks={"LONGITUDINAL": _longitudinal},
    separated_by="coasting from high to low speed separates v^2 (drag) from a constant (rolling resistance, bias)",
    on_every_car=True,
    constant_at="air_force",
    fitted_with_tyres="forces",
    declare=_declare,
)
