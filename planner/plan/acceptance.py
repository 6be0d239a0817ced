"""The last word on a plan: every constraint checked again by equations apart from the solver's.

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
from planner.solver.fixed_check import FixedCheck

RECOVERY_S = 1.5
SHARES, ACROSS = slice(len(LIMITS), len(LIMITS) + 2), slice(len(LIMITS) + 2, len(LIMITS) + 4)
"""rows of `checked_motion.FOUND`"""

TOLERANCES: Mapping[str, float] = {
    "track": 0.10, "load": 0.05, "actuator": 1e-4, "rate": 1e-3, "state": 0.5, "information": 0.05, "dynamics": 1.0,
}  # fmt: skip
"""in the units of `LIMITS`; dynamics in units of `DEFECT_SCALE`"""


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
class CheckedPlan:
    """A trajectory of N+1 stages as it would be published, with the track beside it: `columns` (13, N+1), rows as
    `checked_motion.COLUMNS`; the information of the first stage is 0."""

    columns: Array

    def __getitem__(self, name: str) -> Array:
        """One of `COLUMNS`, (N+1,)."""
        return np.asarray(self.columns[COLUMNS.index(name)])

    def changed(self, **columns: Array) -> CheckedPlan:
        """The same plan with other values of some of `COLUMNS`."""
        made = self.columns.copy(order="F")
        for name, values in columns.items():
            made[COLUMNS.index(name)] = values
        return CheckedPlan(made)


@dataclass(frozen=True)
class Findings:
    """What is found about the N+1 stages of a plan: `rows` as `checked_motion.FOUND`, their `first` column and the
    `largest` value of each after it; `finite`: whether every number of the plan is one."""

    rows: Array
    first: list[float]
    largest: list[float]
    finite: bool

    @property
    def excess(self) -> Array:
        """How far each stage is beyond each of `LIMITS`, in the units of `TOLERANCES`, <= 0 inside, (6, N+1)."""
        return self.rows[: len(LIMITS)]

    @property
    def shares(self) -> Array:
        """Load of the front and of the rear axle over its limit, (2, N+1)."""
        return self.rows[SHARES]

    @property
    def across(self) -> Array:
        """Lateral part of the shares, (2, N+1)."""
        return self.rows[ACROSS]

    @property
    def gaps(self) -> Array:
        """Between each stage and the motion from the one before, (N,)."""
        return self.rows[-1, 1:]


class AcceptanceCheck:
    """Works out `Findings` with a function of `CheckedMotion` and the parameters of its model."""

    def __init__(self, function: CompiledFunction | FixedCheck, theta: Array, phi: Array, brake_ratio: float) -> None:
        """`theta` tyre parameters, `phi` effect parameters, SI, in the order of the model's tables; `brake_ratio` as in
        `BrakeLaw.balance`."""
        self._function, self._parameters = function, (theta[:, None], phi[:, None], brake_ratio)

    def __call__(self, plan: CheckedPlan, bounds: Bounds) -> Findings:
        """Of one plan."""
        function = self._function
        before, after, theta, phi, ratio, limits = function.inputs
        if plan.columns is not after:
            after[:], before[:, 0], before[:, 1:] = plan.columns, plan.columns[:, 0], plan.columns[:, :-1]
        theta[:], phi[:], ratio[:] = self._parameters
        limits[:, 0] = bounds.column
        function()
        rows = function.outputs[0].copy()
        finite = function.finite if isinstance(function, FixedCheck) else bool(np.isfinite(after).all())
        return Findings(rows, rows[:, 0].tolist(), rows[:, 1:].max(axis=1).tolist(), finite)


def violations(found: Findings, bounds: Bounds) -> list[str]:
    """Names of the limits a plan breaks, with the worst value and the stage; empty when it may be published."""
    if not found.finite:
        return ["not finite"]
    most = [bounds.tolerances[name] for name in LIMITS]
    within = all(x <= t for x, t in zip(found.largest, most, strict=False))
    broken = [] if within else _beyond(found.excess, bounds, most)
    if not found.largest[-1] <= bounds.tolerances["dynamics"]:
        at = int(found.gaps.argmax())
        broken.append(f"dynamics: gap {found.gaps[at]:.3g} at stage {at + 1}")
    return broken


def _beyond(excess: Array, bounds: Bounds, tolerances: list[float]) -> list[str]:
    """Limits that are broken by more than what is left of the excess a plan begins with."""
    fade = np.maximum(0.0, 1.0 - bounds.dt / RECOVERY_S * np.arange(1, excess.shape[1]))
    begun = np.maximum(excess[:, :2].max(axis=1), 0.0)
    over = excess[:, 1:] - np.array(tolerances)[:, None] - begun[:, None] * fade
    return [
        f"{name}: {excess[row, at + 1]:.3g} over at stage {at + 1}"
        for row, (name, at) in enumerate(zip(LIMITS, over.argmax(axis=1).tolist(), strict=True))
        if not over[row, at] <= 0.0
    ]
