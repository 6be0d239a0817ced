"""Rigid body on four wheels: wheel loads, wheel velocities, aerodynamic forces, equations of motion.

W. F. Milliken and D. L. Milliken, Race Car Vehicle Dynamics, 1995, ch. 5 (motion), 15 (aerodynamics), 18 (loads).
Order of the wheels everywhere: front left, front right, rear left, rear right. Body axes: x forward, y left.
"""

from __future__ import annotations

from typing import Any

import casadi as ca

from hil_gateway.process.arrays import Expr

FRONT, REAR = (0, 1), (2, 3)
SIDE = (1.0, -1.0, 1.0, -1.0)
"""+1 on the left"""


def wheel_positions(p: Any) -> tuple[list[Expr], list[Expr]]:
    """x and y of the wheels from the centre of gravity, m."""
    return [p.lf, p.lf, -p.lr, -p.lr], [p.lever_arm * y for y in _to_the_left(p)]


def further_left(p: Any) -> list[float]:
    """How much further to the left wheels are than `wheel_positions` has them, m: none but those of a narrow car."""
    return [(1.0 - p.lever_arm) * y for y in _to_the_left(p)]


def _to_the_left(p: Any) -> list[Any]:
    half = (p.track_front / 2, p.track_front / 2, p.track_rear / 2, p.track_rear / 2)
    return [s * h for s, h in zip(SIDE, half, strict=True)]


def positive(load: Expr) -> Expr:
    """Smooth max(load, 0), N: a wheel lifts, it does not pull on the road."""
    return 0.5 * (load + ca.sqrt(load * load + 50.0**2))


def static_loads(p: Any, gravity: Expr) -> list[Expr]:
    """Wheel loads at rest for a normal acceleration `gravity` (m/s2), N."""
    front = 0.5 * p.mass * gravity * p.lr / (p.lf + p.lr)
    rear = 0.5 * p.mass * gravity * p.lf / (p.lf + p.lr)
    return [front, front, rear, rear]


def wheel_loads(p: Any, gravity: Expr, ax: Expr, ay: Expr, downforce: Expr) -> list[Expr]:
    """Loads from weight, specific force of the body (lagged by roll and pitch) and downforce, N.

    Longitudinal transfer m ax h / L; lateral transfer m ay h shared by the axles' roll stiffness, over their track.
    """
    height = p.load_transfer * p.cg_height
    pitch = 0.5 * p.mass * ax * height / (p.lf + p.lr)
    roll_front = p.mass * ay * height * p.roll_share_front / p.track_front
    roll_rear = p.mass * ay * height * (1.0 - p.roll_share_front) / p.track_rear
    air_front = 0.5 * downforce * p.downforce_share_front
    air_rear = 0.5 * downforce * (1.0 - p.downforce_share_front)
    still = static_loads(p, gravity)
    moved = (
        still[0] - pitch - roll_front + air_front,
        still[1] - pitch + roll_front + air_front,
        still[2] + pitch - roll_rear + air_rear,
        still[3] + pitch + roll_rear + air_rear,
    )
    return [positive(load) for load in moved]


def air_forces(p: Any, vx: Expr, vy: Expr, yaw: Expr) -> tuple[Expr, Expr, Expr]:
    """Drag and side force in body axes and downforce, N, against the moving air: k |v| v and k v^2."""
    ux = vx - (p.wind_x * ca.cos(yaw) + p.wind_y * ca.sin(yaw))
    uy = vy - (p.wind_y * ca.cos(yaw) - p.wind_x * ca.sin(yaw))
    speed = ca.sqrt(ux * ux + uy * uy + 1e-6)
    return -p.drag * speed * ux, -p.side * speed * uy, p.downforce * ux * ux


def wheel_velocity(vx: Expr, vy: Expr, yaw_rate: Expr, *, x: Expr, y: Expr, steer: Expr) -> tuple[Expr, Expr]:
    """Velocity of a wheel centre along and across the wheel, m/s."""
    at_x, at_y = vx - yaw_rate * y, vy + yaw_rate * x
    return at_x * ca.cos(steer) + at_y * ca.sin(steer), at_y * ca.cos(steer) - at_x * ca.sin(steer)


def to_body(along: Expr, across: Expr, steer: Expr) -> tuple[Expr, Expr]:
    """Wheel force in body axes, N."""
    return along * ca.cos(steer) - across * ca.sin(steer), along * ca.sin(steer) + across * ca.cos(steer)
