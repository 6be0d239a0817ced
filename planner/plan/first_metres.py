"""Straight ahead at walking pace: what shows where a car points that has not moved since the estimator began."""

from __future__ import annotations

import math

import numpy as np

from hil_gateway.bus.messages import Estimate
from hil_gateway.car.vehicle import GRAVITY
from planner.plan.fallback import StopPlanner, Trajectory
from planner.problem.motion import DRIVE, NU, NZ, PROGRESS, STEER, VX, S

WALKING_PACE = 1.5
"""m/s"""
REACHED_S, GENTLE = 0.5, 1.5
"""s in which a speed is corrected, with so much m/s2 at most: driving off counts from 0.5 m/s after half a second"""


def straight_ahead(  # noqa: PLR0917 - what a plan is made of
    estimate: Estimate, s: float, grade: float, start_ns: int, horizon: int, how: StopPlanner
) -> Trajectory:  # fmt: skip
    """Plan of `horizon` intervals from progress `s` (m) on a road that rises by `grade` (rad): wheels straight, and the
    drive command that walking pace takes. The heading is the estimate's, which is a guess."""
    z, du = np.zeros((NZ, horizon + 1)), np.zeros((NU, horizon))
    z[:4, 0] = estimate.x, estimate.y, estimate.yaw, max(estimate.vx, 0.0)
    most = how.limits.drive_rate * how.dt, how.limits.steer_rate * how.dt

    def towards_pace(speed: float) -> tuple[float, float]:
        """Acceleration (m/s2) and the drive command that makes it."""
        gain = min(max((WALKING_PACE - speed) / REACHED_S, -GENTLE), GENTLE)
        return gain, how.vehicle.mass * (gain + GRAVITY * math.sin(grade)) / how.force_per_drive

    # not from the command reported: that of brakes that hold would ask for brakes again, and the car is held for ever
    z[S, 0], z[DRIVE, 0], z[STEER, 0] = s, towards_pace(z[VX, 0])[1], estimate.steer
    for k in range(horizon):
        before, after = z[:, k], z[:, k + 1]
        gain, wanted = towards_pace(before[VX])
        du[0, k], du[1, k] = np.clip((wanted - before[DRIVE], -before[STEER]), np.negative(most), most)
        after[:] = before
        after[VX] = max(before[VX] + gain * how.dt, 0.0)
        way = 0.5 * (before[VX] + after[VX]) * how.dt
        after[:2] += way * math.cos(estimate.yaw), way * math.sin(estimate.yaw)
        after[S] += way
        after[DRIVE], after[STEER] = before[DRIVE] + du[0, k], before[STEER] + du[1, k]
        after[PROGRESS] = after[VX]
    return Trajectory(z, du, start_ns)
