"""The last word on a plan: every constraint checked again by code that shares nothing with the solver.

Plain numpy on the finished trajectory, Eq. (1) to (5) and (10) written out once more on purpose, the tyre curve of
`estimator.model.tyre` among them: a check that shared it would share its mistakes. A plan is judged by what it
asks of the car from the next stage on; where the car already is beyond a limit (a disturbance, a mismatch of the
model), a plan is let through only if it leads back: the excess it may have fades over `RECOVERY_S`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from hil_gateway.car.vehicle import Vehicle
from hil_gateway.process.arrays import Array

RECOVERY_S = 1.5
KINEMATIC_SPEED = 7.0
"""m/s: below it a plan is kinematic and its slip angles mean nothing; from 5 m/s above it on they count fully"""

TOLERANCES: Mapping[str, float] = {
    "track": 0.10, "load": 0.05, "actuator": 1e-4, "rate": 1e-3, "state": 0.5, "information": 0.05, "dynamics": 1.0,
}  # fmt: skip
"""track m; load, rate, information as shares of their bound; actuator in its own unit (slip, rad); state m/s;
dynamics in units of `DEFECT_SCALE`."""

DEFECT_SCALE = np.array([0.5, 0.5, 0.05, 0.5, 0.5, 0.1])
"""largest gap between a stage and the motion from the one before, m, m, rad, m/s, m/s, rad/s: one SQP iteration leaves
a gap of second order"""


@dataclass(frozen=True)
class AxleForces:
    """Forces along and across both axles and the axle loads, N; arrays (K,), or numbers where all K are the same.

    `beyond_f`, `beyond_r`: how far C atan(B alpha) is beyond the peak, rad.
    """

    fx_f: Array | float
    fy_f: Array | float
    load_f: Array | float
    fx_r: Array | float
    fy_r: Array | float
    load_r: Array | float
    beyond_f: Array | float = 0.0
    beyond_r: Array | float = 0.0


class ForceModel(Protocol):
    """Motion and inputs, arrays (K,), to axle forces; `extra_load` is what the road adds, over the weight."""

    def __call__(
        self, vx: Array, vy: Array, yaw_rate: Array, steer: Array, drive: Array, *, extra_load: Array | float = 0.0
    ) -> AxleForces: ...  # fmt: skip


def declared_forces(vehicle: Vehicle, tyre: Mapping[str, float]) -> ForceModel:
    """Eq. (2) and (3) of the declared model, for layout `per_axle` or `shared`."""
    b, c, d = (np.array([[tyre.get(n + axle, tyre.get(n, 0.0))] for axle in "fr"]) for n in "bcd")
    load_f, load_r = vehicle.static_load_front, vehicle.static_load_rear
    static, arm = np.array([[load_f], [load_r]]), np.array([[vehicle.lf], [-vehicle.lr]])

    def forces(
        vx: Array, vy: Array, yaw_rate: Array, steer: Array, drive: Array, *, extra_load: Array | float = 0.0
    ) -> AxleForces:
        load = static * (1.0 + extra_load * np.ones_like(vx))
        slip = -np.arctan((vy + arm * yaw_rate) / np.maximum(vx, 3.0))
        slip[0] += steer
        phase = c * np.arctan(b * slip)
        (front, rear), beyond = d * load * np.sin(phase), beyond_peak(phase)
        return AxleForces(0.0, front, load[0], tyre["cx"] * drive, rear, load[1], *beyond)

    return forces


def beyond_peak(phase: Array) -> Array:
    """How far C atan(B alpha) of Eq. (2) is beyond the peak of the force, rad."""
    return np.asarray(np.maximum(np.abs(phase) - 0.5 * np.pi, 0.0))


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
    literal_load: bool = False
    information: float = np.inf
    tolerances: Mapping[str, float] = field(default_factory=lambda: dict(TOLERANCES))


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


def excesses(
    plan: Plan, bounds: Bounds, forces: ForceModel, loads: tuple[Array, Array] | None = None
) -> dict[str, Array]:
    """How far each stage is beyond each limit, (N+1,) each, in the units of `TOLERANCES`; <= 0 inside.

    `loads` are those of `load_shares` where they are known already.
    """
    front, rear = loads or load_shares(plan, bounds, forces)
    steer_step, drive_step = bounds.steer_rate * bounds.dt, bounds.drive_rate * bounds.dt
    low, high = bounds.drive
    return {
        "track": np.maximum(
            plan.offset + bounds.clearance - plan.width_left, -plan.offset + bounds.clearance - plan.width_right
        ),
        "load": np.maximum(front, rear) - 1.0,
        "actuator": np.maximum(np.abs(plan.steer) - bounds.steer, np.maximum(plan.drive - high, low - plan.drive)),
        "rate": np.maximum(_steps(plan.steer) / steer_step, _steps(plan.drive) / drive_step) - 1.0,
        "state": np.maximum(plan.vx - bounds.speed, -plan.vx),
        "information": plan.information / bounds.information - 1.0,
    }


def _steps(values: Array) -> Array:
    """Size of the change from the stage before, (N+1,); the first has none."""
    steps = np.zeros_like(values)
    np.abs(values[1:] - values[:-1], out=steps[1:])
    return steps


def load_shares(plan: Plan, bounds: Bounds, forces: ForceModel) -> tuple[Array, Array]:
    """Load of the front and of the rear axle over its limit, Eq. (10), (N+1,) each.

    Beyond the peak the force falls and a share goes on rising: a slide is no way to keep to a limit.
    """
    return shares_of(plan, bounds, stage_forces(plan, forces))


def stage_forces(plan: Plan, forces: ForceModel) -> AxleForces:
    """Forces of both axles at every stage, arrays (N+1,)."""
    return forces(plan.vx, plan.vy, plan.yaw_rate, plan.steer, plan.drive, extra_load=plan.extra_load)


def shares_of(plan: Plan, bounds: Bounds, f: AxleForces) -> tuple[Array, Array]:
    """`load_shares` of forces that are known already."""
    dynamic = np.clip((plan.vx - KINEMATIC_SPEED) / 5.0, 0.0, 1.0)
    f = replace(f, fy_f=dynamic * f.fy_f, fy_r=dynamic * f.fy_r)
    combine = (lambda x, y: np.abs(x + y)) if bounds.literal_load else np.hypot
    front = combine(f.fx_f, f.fy_f) / (bounds.load_max[0] * f.load_f)
    rear = combine(f.fx_r, f.fy_r) / (bounds.load_max[1] * f.load_r)
    return np.asarray(front + dynamic * f.beyond_f), np.asarray(rear + dynamic * f.beyond_r)


def violations(
    plan: Plan, bounds: Bounds, forces: ForceModel, defects: Array | None = None,
    loads: tuple[Array, Array] | None = None,
) -> list[str]:  # fmt: skip
    """Names of the limits a plan breaks, with the worst value and the stage; empty when it may be published.

    `defects` (6, N) are the gaps between each stage and the motion from the one before, by an integrator of the
    caller's choice that is not the solver's; `loads` as for `excesses`.
    """
    columns = [getattr(plan, name) for name in plan.__dataclass_fields__]
    if not np.isfinite(np.concatenate(columns)).all():
        return ["not finite"]
    found = []
    fade = np.maximum(0.0, 1.0 - bounds.dt * np.arange(len(plan.x)) / RECOVERY_S)
    for name, excess in excesses(plan, bounds, forces, loads).items():
        allowed = bounds.tolerances[name] + fade * max(0.0, float(excess[0]), float(excess[1]))
        worst = int(np.argmax(excess[1:] - allowed[1:])) + 1
        if excess[worst] > allowed[worst]:
            found.append(f"{name}: {excess[worst]:.3g} over at stage {worst}")
    if defects is not None:
        gap = np.max(np.abs(defects) / DEFECT_SCALE[:, None], axis=0)
        if gap.max() > bounds.tolerances["dynamics"]:
            found.append(f"dynamics: gap {gap.max():.3g} at stage {int(np.argmax(gap)) + 1}")
    return found
