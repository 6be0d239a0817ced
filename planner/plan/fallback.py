"""What to do without a fresh solution: the last accepted plan shifted, then a stop plan. Never a partial one.

Both have the full horizon. The stop plan needs no optimiser: it steers by pure pursuit of the reference and brakes
until the car stands, harder where a bend ahead would be entered too fast, within the grip that cornering leaves.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hil_gateway.car.vehicle import GRAVITY, Vehicle
from hil_gateway.gateway.perceive.road_speed import STANDSTILL
from hil_gateway.observer.observer import SLOWEST
from hil_gateway.process.arrays import Array
from hil_gateway.settings.gateway import beside
from planner.line.track import Reference
from planner.problem.motion import DRIVE, NU, NZ, PROGRESS, STEER, VX, YAW_RATE, S
from planner.problem.settings import PlanLimits

PREVIEW_S = 0.5
BEND_SHARE = 0.8
"""of the squared speed the profile allows at a point ahead: pursuit cuts and overshoots a bend, a plan does not"""
BEND_PREVIEW = np.arange(5.0, 200.0, 5.0)
"""m ahead at which the profile is looked at: more than the car needs from top speed to any bend"""


@dataclass(frozen=True)
class Trajectory:
    """States (NZ, N+1) at equal steps from `start_ns`, and input changes (NU, N)."""

    z: Array
    du: Array
    start_ns: int


@dataclass(frozen=True)
class StopPlanner:
    """How to stop: motion of one interval, limits, and how hard to brake.

    `step(z, du)` gives the state one interval later. `deceleration` (m/s2) is what every stop brakes with; `grip` is
    the usable force over axle load of the weaker axle; `force_per_drive` (N) turns a force into a drive command.
    """

    step: Callable[[Array, Array], Array]
    reference: Reference
    limits: PlanLimits
    dt: float
    vehicle: Vehicle
    deceleration: float
    grip: float
    force_per_drive: float

    def roll(self, z: Array, intervals: int) -> tuple[Array, Array]:
        """`intervals` states (NZ, n) after `z` and the changes (NU, n) that lead there."""
        states, changes = np.zeros((NZ, intervals)), np.zeros((NU, intervals))
        for k in range(intervals):
            du = self._change(z)
            after = self.step(z, du)
            after[DRIVE], after[STEER] = z[DRIVE] + du[0], z[STEER] + du[1]
            if z[VX] < STANDSTILL:
                after[:7], after[3:6], after[PROGRESS] = z[:7], 0.0, 0.0
            after[PROGRESS] = max(after[VX], 0.0)
            states[:, k], changes[:, k] = after, after[7:] - z[7:]
            z = after
        return states, changes

    def _change(self, z: Array) -> Array:
        steer = self.limits.steer_rate * self.dt
        drive = self.limits.drive_rate * self.dt
        # standing on the brake, or coasting at less than walking pace, where the model would roll backwards
        braking = min(max(self.deceleration, self._for_bends(z)), self._grip_left(z))
        wanted = braking if z[VX] > STANDSTILL else 0.3 * self.deceleration
        target = max(self.limits.drive_min, -wanted * self.vehicle.mass / self.force_per_drive)
        return np.array([
            np.clip(target - z[DRIVE], -drive, drive),
            np.clip(self._pursuit(z) - z[STEER], -steer, steer),
            0.0,
        ])  # fmt: skip

    def _for_bends(self, z: Array) -> float:
        """Deceleration that brings the car to `BEND_SHARE` of what the profile allows at every point ahead, m/s2."""
        distance = np.maximum(BEND_PREVIEW, PREVIEW_S * z[VX])
        allowed = BEND_SHARE * self.reference.speed_limit(z[S] + BEND_PREVIEW) ** 2
        return float(np.max((z[VX] ** 2 - allowed) / (2.0 * distance), initial=0.0))

    def _grip_left(self, z: Array) -> float:
        """Deceleration the friction circle leaves beside the present lateral acceleration, m/s2."""
        grip = self.grip * (GRAVITY + self.vehicle.downforce(float(z[VX])) / self.vehicle.mass)
        return beside(float(z[VX] * z[YAW_RATE]), float(grip))

    def _pursuit(self, z: Array) -> float:
        """Steering angle of pure pursuit (Coulter, 1992), rad."""
        ahead = self.reference.at(np.array([z[S] + PREVIEW_S * max(float(z[VX]), SLOWEST)]))
        dx, dy = float(ahead.x[0] - z[0]), float(ahead.y[0] - z[1])
        lateral = np.cos(z[2]) * dy - np.sin(z[2]) * dx
        angle = np.arctan(2 * self.vehicle.wheelbase * lateral / max(dx**2 + dy**2, 1.0))
        return float(np.clip(angle, -self.limits.steer, self.limits.steer))


def stop_plan(z0: Array, start_ns: int, horizon: int, stopping: StopPlanner) -> Trajectory:
    """Stop from a finite state `z0` (NZ,)."""
    states, changes = stopping.roll(z0, horizon)
    return Trajectory(np.column_stack([z0, states]), changes, start_ns)


def shifted(plan: Trajectory, intervals: int, stopping: StopPlanner) -> Trajectory | None:
    """A plan `intervals` later: what is left of it, completed by stopping; None when nothing is left."""
    horizon = plan.du.shape[1]
    if not 0 <= intervals < horizon:
        return None
    states, changes = stopping.roll(plan.z[:, -1], intervals)
    return Trajectory(
        np.hstack([plan.z[:, intervals:], states]),
        np.hstack([plan.du[:, intervals:], changes]),
        plan.start_ns + round(intervals * stopping.dt * 1e9),
    )
