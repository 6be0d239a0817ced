"""Tyre forces, Eq. (2), and slip angles, Eq. (3). Arguments may be CasADi expressions."""

from __future__ import annotations

import casadi as ca

from hil_gateway.car.vehicle import Vehicle
from hil_gateway.process.arrays import Expr

KINEMATIC_BLEND_RATE = 0.67
"""Wheelbases per second below which slip angles fade to zero instead of diverging: 2 m/s for the AV-24, and in
proportion for a model car."""


def lateral_force(slip: Expr, load: Expr, B: Expr, C: Expr, D: Expr) -> Expr:
    """Eq. (2): F_y = D F_z sin(C atan(B alpha)), N; D is normalised by the axle load F_z."""
    return D * load * ca.sin(C * ca.atan(B * slip))


def longitudinal_force(drive: Expr, C_x: Expr) -> Expr:
    """Eq. (2): F_x = C_x d, N, with d the slip-ratio command."""
    return C_x * drive


def blend_speed(vehicle: Vehicle) -> float:
    """Speed, m/s, below which `safe_speed` departs from vx."""
    return KINEMATIC_BLEND_RATE * vehicle.wheelbase


def safe_speed(vx: Expr, blend: float) -> Expr:
    """Smooth positive denominator for slip: |vx| to 0.02 % above 6 `blend`, never below `blend`."""
    return ca.sqrt(ca.sqrt(vx * vx * vx * vx + blend**4))


def slip_front(vx: Expr, vy: Expr, yaw_rate: Expr, steer: Expr, vehicle: Vehicle) -> Expr:
    """Eq. (3): alpha_f = delta - atan((vy + L_f omega) / vx), rad."""
    return steer - ca.atan((vy + vehicle.lf * yaw_rate) / safe_speed(vx, blend_speed(vehicle)))


def slip_rear(vx: Expr, vy: Expr, yaw_rate: Expr, vehicle: Vehicle) -> Expr:
    """Eq. (3): alpha_r = -atan((vy - L_r omega) / vx), rad."""
    return -ca.atan((vy - vehicle.lr * yaw_rate) / safe_speed(vx, blend_speed(vehicle)))
