"""Prepares a solution for `acceptance`: the plan as it would be published, beside the track, with its bounds.

Offsets and widths come from the race line by plain projection.
"""

from __future__ import annotations

import numpy as np

from estimator.belief.revision import RevisedModel
from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.process.arrays import Array
from planner.line.raceline import OptimisedLine
from planner.plan import acceptance
from planner.plan.acceptance import ACROSS, SHARES, AcceptanceCheck, Bounds
from planner.plan.controller import Controller, TyreKnowledge
from planner.problem.checked_motion import COLUMNS
from planner.problem.motion import MOST_LIFT
from planner.problem.settings import Settings
from planner.solver.fixed_check import WINDOW, FixedCheck
from planner.solver.sqp import Solution

AROUND = np.arange(2 * WINDOW + 1)


class PlanCheck:
    """Checks solutions of one planner.

    `first_loads` are the shares of the load limits at the plan's start, `first_across` their lateral part, `worst_load`
    the largest share after it, `first_gain` is Delta I of its first stage.
    """

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._for: tuple[RevisedModel, TyreKnowledge] | None = None
        self._check: AcceptanceCheck | None = None
        self._roadside: Roadside | None = None
        self._bounds: Bounds | None = None
        """of the last plan, where its drive command starts within its range"""
        self.first_loads, self.first_across, self.worst_load = (0.0, 0.0), (0.0, 0.0), 0.0
        self.first_gain = 0.0

    def __call__(self, controller: Controller, revised: RevisedModel, solution: Solution) -> list[str]:
        """Limits the solution breaks, in words; empty when it may be published."""
        bounds = self._bounds_of(controller.knowledge.load_max, float(solution.z[7, 0]))
        roadside, check = self._roadside_of(controller.reference.line), controller.checked
        roadside.take_share(controller.road_share)
        if isinstance(check, FixedCheck):
            plan = acceptance.CheckedPlan(check.lay_out(solution.z, solution.information, roadside))
        else:
            plan = plan_of(solution, roadside)
        found = self._with_parameters(controller, revised)(plan, bounds)
        front, rear = found.first[SHARES]
        self.first_loads, self.worst_load = (front, rear), max(found.largest[SHARES])
        front, rear = found.first[ACROSS]
        self.first_across = front, rear
        self.first_gain = float(solution.information[0])
        return acceptance.violations(found, bounds)

    def _bounds_of(self, load_max: tuple[float, float], drive: float) -> Bounds:
        """Those of the plan before where nothing else is asked for."""
        limits = self._settings.limits
        within = limits.drive_min <= drive <= limits.drive_max
        if self._bounds is None or not within or self._bounds.load_max != load_max:
            bounds = bounds_of(self._settings, load_max, drive)
            self._bounds = bounds if within else None
            return bounds
        return self._bounds

    def _with_parameters(self, controller: Controller, revised: RevisedModel) -> AcceptanceCheck:
        """With the tyres that the plan is made for, and effect parameters at the start of the lap's profiles."""
        knowledge = controller.knowledge
        if self._check is None or self._for is None or self._for[0] is not revised or self._for[1] is not knowledge:
            self._for = revised, knowledge
            phi = revised.phi_at(np.zeros(1))[:, 0]
            self._check = AcceptanceCheck(controller.checked, knowledge.theta, phi, knowledge.brake_ratio)
        return self._check

    def _roadside_of(self, line: OptimisedLine) -> Roadside:
        """Of the path in use, whose speed profile may be a new one."""
        if self._roadside is None or line.x is not self._roadside.x:
            self._roadside = Roadside(line)
        return self._roadside


def bounds_of(settings: Settings, load_max: tuple[float, float], drive: float) -> Bounds:
    """Limits of Eq. (4), (9), (10); `drive` is where the plan starts, which may still be outside its range."""
    limits, info = settings.limits, settings.information
    return Bounds(
        dt=settings.dt, steer=limits.steer, steer_rate=limits.steer_rate,
        drive=(min(limits.drive_min, drive), max(limits.drive_max, drive)), drive_rate=limits.drive_rate,
        speed=limits.speed, load_max=load_max, clearance=limits.car_half_width,
        information=info.bound if info.weight > 0 else np.inf,
    )  # fmt: skip


class Roadside:
    """Points of a race line's path with what is beside them."""

    def __init__(self, line: OptimisedLine) -> None:
        self.x, self.spacing = line.x, line.length / len(line.x)
        cos, sin = np.cos(line.heading), np.sin(line.heading)
        widths = [line.width_left, line.width_right]
        slopes = [(np.roll(w, -1) - np.roll(w, 1)) / (2.0 * self.spacing) for w in widths]
        flat = np.cos(line.grade) * np.cos(line.bank) - 1.0
        self._load = np.array([line.bend, np.sin(line.bank)]) / GRAVITY
        self._slopes = np.array([line.grade, line.bank])
        self._share = np.ones(2)
        self.points = np.array([line.x, line.y, cos, sin, *widths, *slopes, flat, *self._load, *self._slopes])
        self._pull()

    def _pull(self) -> None:
        share = self._share[:, None]
        self.points[9:11] = share * self._load
        self.points[11:13] = -GRAVITY * np.sin(share * self._slopes)

    def take_share(self, share: Array) -> None:
        """Shares (2,) of the line's grade and bank that are real."""
        if np.any(share != self._share):
            self._share = share
            self._pull()

    def near(self, x: Array, y: Array, s: Array) -> Array:
        """Rows of the nearest points (13, K) to points near progress `s`, all (K,).

        x, y, cosine and sine of the heading, widths to the left and right and their slopes, and what the road adds to
        the axle loads, over the weight: r0 + r1 vx^2 - r2 vx omega in three rows; gravity along and across, m/s2.
        """
        n = len(self.x)
        first = np.round(s * (1.0 / self.spacing)).astype(np.intp) - WINDOW
        around = self.points[:2].take((first[:, None] + AROUND) % n, axis=1)
        nearest = ((x[:, None] - around[0]) ** 2 + (y[:, None] - around[1]) ** 2).argmin(axis=1)
        return np.asarray(self.points.take((first + nearest) % n, axis=1))


def plan_of(solution: Solution, roadside: Roadside) -> acceptance.CheckedPlan:
    """The solution beside the race line."""
    z = solution.z
    road = roadside.near(z[0], z[1], z[6])
    (dx, dy), (cos, sin), (vx, yaw_rate) = z[:2] - road[:2], road[2:4], z[3:6:2]
    columns = np.empty((len(COLUMNS), z.shape[1]), order="F")
    columns[:6], columns[6:8] = z[:6], z[8:6:-1]
    columns[8] = np.maximum(road[8] + vx * (vx * road[9] - yaw_rate * road[10]), -MOST_LIFT)
    columns[9] = cos * dy - sin * dx
    columns[10:12] = road[4:6] + (cos * dx + sin * dy) * road[6:8]
    columns[12, 0], columns[12, 1:] = 0.0, solution.information
    columns[13:15] = road[11:13]
    return acceptance.CheckedPlan(columns)
