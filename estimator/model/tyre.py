"""Tyre forces, Eq. (2), and slip angles, Eq. (3). Arguments may be CasADi expressions."""

from __future__ import annotations

from typing import Any

import casadi as ca

Expr = Any
"""CasADi SX/MX or a float: CasADi overloads both alike and has no common static type."""

KINEMATIC_BLEND_SPEED = 2.0
"""Below about this vx, m/s, slip angles fade to zero instead of diverging."""


def lateral_force(slip: Expr, load: Expr, B: Expr, C: Expr, D: Expr) -> Expr:
    """Eq. (2): F_y = D F_z sin(C atan(B alpha)), N; D is normalised by the axle load F_z."""
    return D * load * ca.sin(C * ca.atan(B * slip))


def longitudinal_force(drive: Expr, C_x: Expr) -> Expr:
    """Eq. (2): F_x = C_x d, N, with d the slip-ratio command."""
    return C_x * drive


def safe_speed(vx: Expr, blend: float = KINEMATIC_BLEND_SPEED) -> Expr:
    """Smooth positive denominator for slip: tends to vx well above `blend`, never below about blend / 2."""
    return 0.5 * (vx + ca.sqrt(vx * vx + blend * blend))


def slip_front(vx: Expr, vy: Expr, yaw_rate: Expr, steer: Expr, lf: float) -> Expr:
    """Eq. (3): alpha_f = delta - atan((vy + L_f omega) / vx), rad."""
    return steer - ca.atan((vy + lf * yaw_rate) / safe_speed(vx))


def slip_rear(vx: Expr, vy: Expr, yaw_rate: Expr, lr: float) -> Expr:
    """Eq. (3): alpha_r = -atan((vy - L_r omega) / vx), rad."""
    return -ca.atan((vy - lr * yaw_rate) / safe_speed(vx))
