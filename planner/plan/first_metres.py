"""Straight ahead at walking pace: what shows where a car points that has not moved since the estimator began.

No faster than the car can stop from before an edge, whichever way it points of those that the estimate's deviations
leave; as soon as they leave fewer, edges beside its way limit it no more.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hil_gateway.bus.messages import Estimate
from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.track.track import Track
from planner.plan.fallback import StopPlanner, Trajectory
from planner.problem.motion import DRIVE, NU, NZ, PROGRESS, STEER, VX, S

WALKING_PACE = 1.5
"""m/s"""
REACHED_S, GENTLE = 0.5, 1.5
"""s in which a speed is corrected, with so much m/s2 at most: driving off counts from 0.5 m/s after half a second"""


@dataclass(frozen=True)
class WayLeft:
    """Where a car stands whose heading is not known: how far it may go whichever way it points, m, to which `side`; the
    road rises by `grade`, rad."""

    metres: float
    side: str
    grade: float

    @classmethod
    def of(cls, estimate: Estimate, track: Track, half_width: float, level: float) -> WayLeft:
        """With `level` standard deviations of the estimate."""
        s, lateral = track.project(estimate.x, estimate.y)
        at, room = track.at(s), track.room(s, lateral)
        beside = half_width + level * max(estimate.std[:2])
        across, spread = estimate.yaw - float(at.heading), level * estimate.std[2]
        ways = {
            side: (float(space) - beside) / max(_steepest(sign * across, spread), LEAST_SLOPE)
            for side, space, sign in (("left", room.left, 1.0), ("right", room.right, -1.0))
        }
        side = min(ways, key=lambda name: ways[name])
        return cls(ways[side], side, float(at.grade))

    @property
    def reason(self) -> str:
        """Why a car with no way left does not drive off."""
        return f"where the car points is not known, and the {self.side} edge is too near: push it forward by 3 m"


LEAST_SLOPE = 1e-3
"""of a way to an edge: one beside which the car goes is a kilometre away"""


def _steepest(angle: float, spread: float) -> float:
    """Largest sine of the angles within `spread` of one, rad."""
    off = max(abs(math.remainder(angle - 0.5 * math.pi, math.tau)) - spread, 0.0)
    return math.cos(off)


def straight_ahead(  # noqa: PLR0917 - what a plan is made of
    estimate: Estimate, s: float, way: WayLeft, start_ns: int, horizon: int, how: StopPlanner
) -> Trajectory:  # fmt: skip
    """Plan of `horizon` intervals from progress `s` (m): wheels straight, and the drive command that walking pace, or
    less where there is little way left, takes. The heading is the estimate's, which is a guess."""
    z, du = np.zeros((NZ, horizon + 1)), np.zeros((NU, horizon))
    z[:4, 0] = estimate.x, estimate.y, estimate.yaw, max(estimate.vx, 0.0)
    most = how.limits.drive_rate * how.dt, how.limits.steer_rate * how.dt

    def towards_pace(speed: float, gone: float) -> tuple[float, float]:
        """Acceleration (m/s2) after so many m, and the drive command that makes it."""
        pace = min(WALKING_PACE, math.sqrt(2.0 * GENTLE * max(way.metres - gone, 0.0)))
        gain = min(max((pace - speed) / REACHED_S, -GENTLE), GENTLE)
        return gain, how.vehicle.mass * (gain + GRAVITY * math.sin(way.grade)) / how.force_per_drive

    # not from the command reported: that of brakes that hold would ask for brakes again, and the car is held for ever
    z[S, 0], z[DRIVE, 0], z[STEER, 0] = s, towards_pace(z[VX, 0], 0.0)[1], estimate.steer
    for k in range(horizon):
        before, after = z[:, k], z[:, k + 1]
        gain, wanted = towards_pace(before[VX], before[S] - s)
        du[0, k], du[1, k] = np.clip((wanted - before[DRIVE], -before[STEER]), np.negative(most), most)
        after[:] = before
        after[VX] = max(before[VX] + gain * how.dt, 0.0)
        step = 0.5 * (before[VX] + after[VX]) * how.dt
        after[:2] += step * math.cos(estimate.yaw), step * math.sin(estimate.yaw)
        after[S] += step
        after[DRIVE], after[STEER] = before[DRIVE] + du[0, k], before[STEER] + du[1, k]
        after[PROGRESS] = after[VX]
    return Trajectory(z, du, start_ns)
