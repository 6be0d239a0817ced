"""Engine, gears, limited-slip rear axle and brakes: torques at the wheels.

L. Guzzella and A. Sciarretta, Vehicle Propulsion Systems, 2013, ch. 2 and 3; locking differential: Milliken and
Milliken, ch. 20.
"""

from __future__ import annotations

from typing import Any

import casadi as ca

from hil_gateway.plant.physics.parameters import ENGINE_SPEEDS
from hil_gateway.process.arrays import Expr

BRAKE_STIFFNESS = 1200.0
"""1/s, the quickest a brake may stop a wheel: what the 1 kHz integration can follow"""
LEAST_TORQUE = 1e-6
"""N m; keeps the division finite with the brakes off"""
CLOSED, CLOSED_WIDTH = 0.015, 0.004
"""throttle below which fuel is cut, and the width of that switch"""
LOCKING = 3.0
"""rad/s of difference between the rear wheels at which the differential locks at its full torque"""
LIMITER = 50.0
"""rad/s above the last point of the map within which the limiter takes the torque away"""


def full_throttle_torque(at: Expr, torques: list[Expr], scale: Expr = 1.0) -> Expr:
    """Engine map at a speed, linear between its points, constant before, cut off after, N m; `scale` of its speeds."""
    total, speed = torques[0], at / scale
    for i in range(len(ENGINE_SPEEDS) - 1):
        low, high = ENGINE_SPEEDS[i], ENGINE_SPEEDS[i + 1]
        slope = (torques[i + 1] - torques[i]) / (high - low)
        total = total + slope * (ca.fmin(ca.fmax(speed, low), high) - low)
    return total * (1.0 - ca.fmin(ca.fmax((speed - ENGINE_SPEEDS[-1]) / LIMITER, 0.0), 1.0))


def engine_speed(p: Any, axle_speed: Expr, ratio: Expr) -> Expr:
    """Engine speed behind the clutch, rad/s; the clutch slips below `engine_clutch`."""
    return ca.fmax(axle_speed * ratio, p.engine_clutch)


def axle_torque(p: Any, throttle: Expr, speed: Expr, ratio: Expr, running: Expr) -> Expr:
    """Torque of the engine at the rear axle, both wheels together, N m; `ratio` 0 is neutral.

    With the throttle closed fuel is cut, and the engine drags once the clutch grips.
    """
    turning = ca.fmin(ca.fmax(speed / p.engine_clutch - 1.0, 0.0) * 4.0, 1.0)
    drive = running * throttle * full_throttle_torque(speed, p.engine_torque, p.engine_speed_scale)
    closed = 0.5 * (1.0 - ca.tanh((throttle - CLOSED) / CLOSED_WIDTH))
    drag = p.engine_drag * p.wheel_radius * closed * turning
    return ratio * p.driveline_efficiency * drive - ca.fmin(ratio, 1.0) * drag


def differential(p: Any, torque: Expr, speed_left: Expr, speed_right: Expr) -> tuple[Expr, Expr]:
    """Torque of each rear wheel, N m: half each, plus a locking torque from the quicker to the slower wheel."""
    locking = (p.lsd_preload + p.lsd_ramp * ca.fabs(torque)) * ca.tanh((speed_left - speed_right) / LOCKING)
    return 0.5 * torque - 0.5 * locking, 0.5 * torque + 0.5 * locking


def brake_torques(
    p: Any, front: Expr, rear: Expr, *, speeds: list[Expr], others: list[Expr], inertia: list[Expr]
) -> list[Expr]:
    """Torque of each brake, N m, from circuit pressures (Pa): dry friction against the wheel's rotation (rad/s).

    As much as stops the wheel against the `others` torques on it (N m), up to what the pressure gives: a wheel that
    stands stays where it is.
    """
    on_front = p.front_brake * p.brake_gain_front * front
    on_rear = p.brake_gain_rear * rear + (1.0 - p.front_brake) * p.brake_gain_front * front
    most = (on_front, on_front, on_rear, on_rear)
    stopping = [o + i * BRAKE_STIFFNESS * w for o, i, w in zip(others, inertia, speeds, strict=True)]
    return [-m * ca.fmax(-1.0, ca.fmin(1.0, s / (m + LEAST_TORQUE))) for m, s in zip(most, stopping, strict=True)]
