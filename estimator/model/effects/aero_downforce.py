"""Aerodynamic downforce: axle loads, and with them D F_z, grow with the square of speed."""

from __future__ import annotations

from estimator.model.effect import DeclaredParameter, Effect
from estimator.model.parameters import Parameter, Plausible, Quantity
from estimator.model.single_track import Terms
from hil_gateway.car.car import Car
from hil_gateway.process.arrays import Expr


def _declare(car: Car) -> tuple[DeclaredParameter, ...]:
    def of_axle(key: str) -> DeclaredParameter:
        pressed = 0.5 * car.vehicle.air_density
        return DeclaredParameter(-pressed * float(getattr(car.vehicle, key)), pressed * car.std(f"vehicle.{key}"))

    return of_axle("lift_area_front"), of_axle("lift_area_rear")


def _load(terms: Terms, k_front: Expr, k_rear: Expr) -> None:
    terms.load_f = terms.load_f + k_front * terms.vx * terms.vx
    terms.load_r = terms.load_r + k_rear * terms.vx * terms.vx


EFFECT = Effect(
    name="aero_downforce",
    lacks="axle loads, and so D F_z, grow with v^2",
    equation="F_z,i = F_z0,i + k_i v_x^2",
    source="Milliken & Milliken, Race Car Vehicle Dynamics, ch. 3",
    parameters=(
        Parameter(
            "k_front",
            "N s2/m2",
            0.0,
            0.5,
            0.0,
            4.0,
            "-rho Cl A / 2, front axle",
            Plausible(0.0, 3.0, "rho Cl A / 2 per axle: single-seaters 0.5 to 2.5, any body 0.05", 0.05),
            quantity=Quantity.DOWNFORCE,
        ),
        Parameter(
            "k_rear",
            "N s2/m2",
            0.0,
            0.5,
            0.0,
            4.0,
            "-rho Cl A / 2, rear axle",
            Plausible(0.0, 3.0, "rho Cl A / 2 per axle: single-seaters 0.5 to 2.5, any body 0.05", 0.05),
            quantity=Quantity.DOWNFORCE,
        ),
    ),
    fitted_with_tyres="loads",
    declare=_declare,
    channels=("ay", "yaw_acc", "vy_dot"),
    cause="vx",
    hooks={"LOAD": _load},
    separated_by="the same corner at very different speeds",
    on_every_car=True,
)
