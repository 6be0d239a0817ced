"""QPs of a drive with the car off its plan: how many a solver solves alone."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hil_gateway.process.arrays import Array
from planner.problem.motion import DRIVE, NZ, STEER, VX
from planner.problem.mpcc import Problem
from planner.solver.functions import Functions
from planner.solver.qp import QpStatus
from planner.solver.sqp import Sqp, Step, Stopwatch

SCALE = np.array([3.0, 3.0, 0.2, 6.0, 3.0, 0.6, 2.0, 0.05, 0.05, 6.0])
"""standard deviation of a start that is badly off, in the units of z: 3 m, 0.2 rad, 6 m/s and more"""
LEVELS = (0.0, 0.3, 1.0)
"""shares of `SCALE`: the recorded steps as they were, a rough ride, badly off"""
LEAST, MOST = np.array([-0.16, -0.26, 1.0]), np.array([0.12, 0.26, 85.0])
"""of drive, steering (rad) and speed (m/s): a car has none beyond"""


@dataclass
class Alone:
    """Second solver that solves nothing, so that the first one is seen alone."""

    name: str = "none"
    iterations: int = 0

    def solve(self) -> QpStatus:
        """No solution."""
        return QpStatus.ITERATION_LIMIT


class FirstSolverOnly(Sqp):
    """The generated solver without the one behind it."""

    def __init__(self, problem: Problem, functions: Functions) -> None:
        super().__init__(problem, functions, "fixed")
        self._solver = Alone()


def disturbed(step: Step, level: float, rng: np.random.Generator) -> Step:
    """A step whose car starts `level` times `SCALE` off the guess."""
    if level == 0.0:
        return step
    start: Array = step.z[:, 0] + level * SCALE * rng.standard_normal(NZ)
    start[[DRIVE, STEER, VX]] = np.clip(start[[DRIVE, STEER, VX]], LEAST, MOST)
    return replace(step, z0=start)


def solved(
    sqp: Sqp, steps: Sequence[Step], level: float, numbers: Iterable[int], stopwatch: Stopwatch
) -> dict[str, Any]:
    """How many QPs `sqp` solves at a level, one a number; the same seed gives the same QPs to every solver."""
    rng, usable, count = np.random.default_rng(4), 0, 0
    for k in numbers:
        step = disturbed(steps[k % len(steps)], level, rng)
        sqp.set_guess(step.z.copy(), step.du.copy())
        usable += sqp.solve_step(step, stopwatch).usable
        count += 1
    return {"level": level, "qps": count, "solved": usable, "share": round(usable / count, 5)}
