"""The last word on a plan: every constraint checked again by code that shares nothing with the solver.

The equations are those of `planner.problem.checked_motion`. A plan is judged by what it asks of the car from the next
stage on; where the car already is beyond a limit (a disturbance, a mismatch of the model), a plan is let through only
if it leads back: the excess it may have fades over `RECOVERY_S`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from hil_gateway.process.arrays import Array
from hil_gateway.process.compiled import CompiledFunction
from planner.problem.checked_motion import COLUMNS, LIMITS

RECOVERY_S = 1.5

TOLERANCES: Mapping[str, float] = {
    "track": 0.10, "load": 0.05, "actuator": 1e-4, "rate": 1e-3, "state": 0.5, "information": 0.05, "dynamics": 1.0,
}  # fmt: skip
"""track m; load, rate, information as shares of their bound; actuator in its own unit (slip, rad); state m/s;
dynamics in units of `DEFECT_SCALE`."""

DEFECT_SCALE = np.array([0.5, 0.5, 0.05, 0.5, 0.5, 0.1])
"""largest gap between a stage and the motion from the one before, m, m, rad, m/s, m/s, rad/s: one SQP iteration leaves
a gap of second order"""


@dataclass(frozen=True)
class Bounds:
    """What a plan must keep to.

    `load_max` F-bar over axle load (front, rear); `drive` (min, max); rates a second; `clearance` (m) from the track's
    edges to the CoG; `information` the bound on Delta I a stage (inf without).
    """

    dt: float
    steer: float
    steer_rate: float
    drive: tuple[float, float]
    drive_rate: float
    speed: float
    load_max: tuple[float, float]
    clearance: float
    information: float = np.inf
    tolerances: Mapping[str, float] = field(default_factory=lambda: dict(TOLERANCES))

    @property
    def column(self) -> tuple[float, ...]:
        """In the order of `checked_motion.BOUNDS`."""
        return (
            self.dt, self.steer, self.steer_rate, *self.drive, self.drive_rate, self.speed, *self.load_max,
            self.clearance, self.information,
        )  # fmt: skip


@dataclass(frozen=True)
class Plan:
    """A trajectory as it would be published, arrays (N+1,), with the track beside it.

    `offset` is the lateral distance from the reference line (m, positive left), `width_left`, `width_right` the
    distances from that line to the edges, `extra_load` what the road adds to
    the axle loads over the weight, `information` Delta I of each stage (first one unused).
    """

    x: Array
    y: Array
    yaw: Array
    vx: Array
    vy: Array
    yaw_rate: Array
    drive: Array
    steer: Array
    offset: Array
    width_left: Array
    width_right: Array
    extra_load: Array
    information: Array


@dataclass(frozen=True)
class Findings:
    """What is found about the N+1 stages of a plan.

    `excess` (6, N+1): how far each stage is beyond each of `LIMITS`, in the units of `TOLERANCES`, <= 0 inside;
    `shares` (2, N+1): load of the front and of the rear axle over its limit; `gaps` (6, N): between each stage and the
    motion from the one before; `finite`: whether every number of the plan is one.
    """

    excess: Array
    shares: Array
    gaps: Array
    finite: bool


class Check:
    """Works out `Findings` with a function of `CheckedMotion` and the parameters of its model."""

    def __init__(self, function: CompiledFunction, theta: Array, phi: Array) -> None:
        """`theta` tyre parameters, `phi` effect parameters, SI, in the order of the model's tables."""
        self._function, self._parameters = function, (theta[:, None], phi[:, None])

    def __call__(self, plan: Plan, bounds: Bounds) -> Findings:
        """Of one plan."""
        before, after, theta, phi, limits = self._function.inputs
        for row, name in enumerate(COLUMNS):
            after[row] = getattr(plan, name)
        before[:, 0], before[:, 1:] = after[:, 0], after[:, :-1]
        theta[:], phi[:] = self._parameters
        limits[:, 0] = bounds.column
        self._function()
        excess, shares, gaps = (output.copy() for output in self._function.outputs)
        return Findings(excess, shares, gaps[:, 1:], bool(np.isfinite(after).all()))


def violations(found: Findings, bounds: Bounds) -> list[str]:
    """Names of the limits a plan breaks, with the worst value and the stage; empty when it may be published."""
    if not found.finite:
        return ["not finite"]
    excess, stages = found.excess, np.arange(1, found.excess.shape[1])
    fade = np.maximum(0.0, 1.0 - bounds.dt / RECOVERY_S * stages)
    tolerance = np.array([bounds.tolerances[name] for name in LIMITS])
    over = excess[:, 1:] - tolerance[:, None] - np.maximum(excess[:, :2].max(axis=1), 0.0)[:, None] * fade
    worst = over.argmax(axis=1)
    broken = [
        f"{name}: {excess[row, at + 1]:.3g} over at stage {at + 1}"
        for row, (name, at) in enumerate(zip(LIMITS, worst.tolist(), strict=True))
        if over[row, at] > 0.0
    ]
    gap = (np.abs(found.gaps) / DEFECT_SCALE[:, None]).max(axis=0)
    if gap.max() > bounds.tolerances["dynamics"]:
        broken.append(f"dynamics: gap {gap.max():.3g} at stage {int(gap.argmax()) + 1}")
    return broken
