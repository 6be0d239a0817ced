"""Prepares a solution for `acceptance`: the plan as it would be published, beside the track, with its bounds.

Offsets and widths come from the race line by plain projection.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from estimator.belief.revision import RevisedModel
from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.process.arrays import Array
from planner.adoption.adoption import Adopted
from planner.line.raceline import RaceLine
from planner.plan import acceptance
from planner.plan.acceptance import Bounds, Check
from planner.plan.controller import Controller
from planner.problem.motion import MOST_LIFT
from planner.problem.settings import Settings
from planner.solver.sqp import Solution

WINDOW = 6
"""points of the race line either side of the predicted progress among which the nearest is sought"""
AROUND = np.arange(2 * WINDOW + 1)


class PlanCheck:
    """Checks solutions of one planner.

    `first_loads` are the shares of the load limits at the plan's start, `worst_load` the largest share after it,
    `first_gain` is Delta I of its first stage.
    """

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._model: RevisedModel | None = None
        self._check: Check | None = None
        self.first_loads, self.worst_load = (0.0, 0.0), 0.0
        self.first_gain = 0.0

    def __call__(self, controller: Controller, adopted: Adopted, solution: Solution) -> list[str]:
        """Limits the solution breaks, in words; empty when it may be published."""
        bounds = bounds_of(self._settings, controller.knowledge.load_max, float(solution.z[7, 0]))
        found = self._with_parameters(controller, adopted)(plan_of(solution, controller.reference.line), bounds)
        front, rear = found.shares[:, 0].tolist()
        self.first_loads, self.worst_load = (front, rear), float(found.shares[:, 1:].max())
        self.first_gain = float(solution.information[0])
        return acceptance.violations(found, bounds)

    def _with_parameters(self, controller: Controller, adopted: Adopted) -> Check:
        """With effect parameters at the start of the lap's profiles."""
        if self._check is None or adopted.revised is not self._model:
            self._model = adopted.revised
            phi = adopted.revised.phi_at(np.zeros(1))[:, 0]
            self._check = Check(controller.checked, adopted.revised.theta, phi)
        return self._check


def bounds_of(settings: Settings, load_max: tuple[float, float], drive: float) -> Bounds:
    """Limits of Eq. (4), (9), (10); `drive` is where the plan starts, which may still be outside its range."""
    limits, info = settings.limits, settings.information
    return Bounds(
        dt=settings.dt, steer=limits.steer, steer_rate=limits.steer_rate,
        drive=(min(limits.drive_min, drive), max(limits.drive_max, drive)), drive_rate=limits.drive_rate,
        speed=limits.speed, load_max=load_max, clearance=limits.car_half_width,
        information=info.bound if info.weight > 0 else np.inf,
    )  # fmt: skip


def plan_of(solution: Solution, line: RaceLine) -> acceptance.Plan:
    """The solution beside the race line."""
    z = solution.z
    offset, width_left, width_right, index = beside(z[0], z[1], z[6], line)
    return acceptance.Plan(
        x=z[0], y=z[1], yaw=z[2], vx=z[3], vy=z[4], yaw_rate=z[5], drive=z[7], steer=z[8], offset=offset,
        width_left=width_left, width_right=width_right, extra_load=_extra_load(line, index, z[3], z[5]),
        information=np.concatenate([[0.0], solution.information]),
    )  # fmt: skip


def _extra_load(line: RaceLine, index: npt.NDArray[np.intp], vx: Array, yaw_rate: Array) -> Array:
    """What the road adds to the axle loads at points of the line, over the weight, (K,)."""
    grade, bank, bend = line.grade[index], line.bank[index], line.bend[index]
    added = np.cos(grade) * np.cos(bank) - 1.0 + vx * (vx * bend - yaw_rate * np.sin(bank)) / GRAVITY
    return np.asarray(np.maximum(added, -MOST_LIFT))


def beside(x: Array, y: Array, s: Array, line: RaceLine) -> tuple[Array, Array, Array, npt.NDArray[np.intp]]:
    """Distance to the left of the line (m) of points (K,) near progress `s`, the line's distance to both edges, and
    the nearest point of the line."""
    n = len(line.s)
    first = np.round(s * (n / line.length)).astype(np.intp) - WINDOW
    index = (first[:, None] + AROUND) % n
    nearest = ((x[:, None] - line.x.take(index)) ** 2 + (y[:, None] - line.y.take(index)) ** 2).argmin(axis=1)
    i = (first + nearest) % n
    dx, dy, heading = x - line.x.take(i), y - line.y.take(i), line.heading.take(i)
    cos, sin = np.cos(heading), np.sin(heading)
    cells = (cos * dx + sin * dy) * n / line.length
    left, right = (w[i] + cells * 0.5 * (w[(i + 1) % n] - w[i - 1]) for w in (line.width_left, line.width_right))
    return cos * dy - sin * dx, left, right, i
