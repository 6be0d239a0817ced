"""One solver with its parameters: from the car's state to a solution of the optimal-control problem.

Holds what changes slowly (model, belief, reference, load limits) as parameter vectors of the compiled functions, so
that a new belief or race line needs no new code; only another list of active effects does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from estimator.model.parameters import Quantity
from estimator.model.tyre import front_and_rear
from hil_gateway.process.arrays import Array
from planner.line.track import Reference
from planner.plan.prediction import AT_ONCE, Car, Held, Late
from planner.problem import infomax
from planner.problem.motion import DRIVE, NU, PROGRESS, VX, YAW_RATE, S, extra_load
from planner.problem.mpcc import ADVANCE_STEPS, Problem
from planner.solver.functions import Functions
from planner.solver.sqp import Solution, Sqp, Stopwatch

COLD_START_ITERATIONS = 15
STILL: Held = (0.0, 0.0, 0.0)
"""a step that takes no time"""
MIN_CORRIDOR = 0.2
"""half the width, m, left to the CoG where the track is narrower than car and margin"""
MIN_POWER_SPEED = 10.0
"""below this the drive command is not limited by engine power, m/s"""


@dataclass(frozen=True)
class TyreKnowledge:
    """Tyre parameters the motion is predicted with, and the belief about them.

    `theta`, `mean` (n,), `covariance` (n, n), `prior_std` (n,); front and rear: `load_max` the limits F-bar
    by which loads are judged, over axle load; `load_asked` the share of its tyres' own peak that an axle may use in a
    plan, whatever theta is (Eq. 10); `capacity` the force over axle load that the speed profile may ask for.
    """

    theta: Array
    mean: Array
    covariance: Array
    prior_std: Array
    load_max: tuple[float, float]
    load_asked: tuple[float, float]
    capacity: tuple[float, float]
    brake_ratio: float = 1.0
    """front over rear brake pressure for equal axle loads (`brake_law.pressure_ratio`)"""
    level: float = 2.0
    """standard deviations of the belief with which Eq. (10) holds"""
    brake_doubt: tuple[float, float] = (1.0, 1.0)
    """how many times braking forces of front and rear axle count in Eq. (10), for what is not known of the brakes"""
    delivered: tuple[float, float] = (1.0, 1.0)
    """share of their believed peak that front and rear tyres deliver now: in all the above but `load_max`"""

    @property
    def load_left(self) -> tuple[float, float]:
        """F-bar of what front and rear tyres deliver now."""
        return self.load_max[0] * self.delivered[0], self.load_max[1] * self.delivered[1]

    @cached_property
    def spread(self) -> float:
        """Of the belief over the prior's (`infomax.relative_spread`)."""
        return infomax.relative_spread(self.covariance, self.prior_std)


PhiAt = Callable[[Array], Array]
"""effect parameters (n_phi, K) at track positions (K,), m"""


def _no_effects(track_position: Array) -> Array:
    return np.zeros((0, len(track_position)))


class Controller:
    """MPCC of one model and settings on one reference."""

    def __init__(
        self, problem: Problem, functions: Functions, reference: Reference, knowledge: TyreKnowledge,
        *, phi_at: PhiAt | None = None, backend: str = "auto",
    ) -> None:  # fmt: skip
        self.problem, self.settings = problem, problem.settings
        self.sqp = Sqp(problem, functions, backend)
        self._advance, self.checked = functions.advance, functions.checked
        self.phi_at = phi_at or _no_effects
        place_of = problem.model.place_of
        self._brakes_in_front = place_of(Quantity.FRONT_BRAKE_SHARE) is not None
        self._map_pulls = np.array([float(place_of(q) is None) for q in (Quantity.GRADE, Quantity.BANK)])
        self.take_road(1.0, 1.0)
        self.reference = reference
        self.common = np.zeros(self.problem.common.size)
        self.stages = np.zeros((self.problem.stage.size, self.settings.horizon), order="F")
        self.set_knowledge(knowledge)
        self.stages[problem.stage["progress"], :-1] = self.settings.weights.progress
        # the last one would push v_s against the horizon's end: its weight stays 0
        self.stages[problem.stage["learning"]] = infomax.patience(self.settings.dt, self.settings.horizon)
        self.take_sent(np.zeros((2, self.settings.horizon + 1)), AT_ONCE)
        self._filled: tuple[Array, Reference, PhiAt] | None = None
        """what the stage parameters were filled for"""
        self._known: tuple[Array, TyreKnowledge, float, Array] | None = None
        """guess, knowledge and what `_known_ahead` found for them"""
        # `advance` is asked before the first solve: a scale that is still 0 would divide by zero
        self.fill_stages(0.0)

    def take_road(self, grade: float, bank: float) -> None:
        """Shares of the map's grade and bank that are real, as the state filter knows them.

        An effect learnt from data stands for grade or bank as they are felt: not both.
        """
        self.road_share = self._map_pulls * (grade, bank)

    def set_knowledge(self, knowledge: TyreKnowledge) -> None:
        """Take over tyre parameters, belief and load limits; no recompilation."""
        self.knowledge = knowledge
        k, names, info = knowledge, self.problem.common, self.settings.information
        values: dict[str, npt.ArrayLike] = {
            "theta": k.theta,
            "lap": self.reference.length,
            "load_max": k.load_asked,
            "brake_ratio": k.brake_ratio,
            "brake_doubt": k.brake_doubt,
            "sigma_f": self._choices(0),
            "sigma_r": self._choices(1),
            "information_theta": k.mean,
            "trace_weight": k.prior_std**2,
            "q_information": info.weight,
        }
        for name, value in values.items():
            self.common[names[name]] = value

    def _choices(self, axle: int) -> Array:
        """theta in force, then the sigma points of the parameters of the front (0) or rear axle (1) and the one with
        the least peak force, column after column."""
        k, model, level = self.knowledge, self.problem.model, self.knowledge.level
        indices = model.load_rows[axle]
        *_, peak = front_and_rear(model.layout)[axle].rows([p.name for p in model.tyre_table])
        points = infomax.sigma_points(k.mean, k.covariance, indices, level)
        weakest = infomax.least_of(k.mean, k.covariance, indices, peak, level)
        return np.column_stack([k.theta, points, weakest]).ravel(order="F")

    def _weigh_information(self, speed: float, share: float = 1.0) -> None:
        """q_I at this speed, what exploring leaves of the load limits, and W of Tr(W F)."""
        k, info, names = self.knowledge, self.settings.information, self.problem.common
        if not self.problem.informative:
            self.common[names["load_max"]] = k.load_asked
            return
        spread, W = self._known_ahead()
        q = share * infomax.scheduled_weight(info.weight, speed, spread, info.goal)
        swing = self.settings.limits.exploring_reserve if q > 0 else 0.0
        self.common[names["load_max"]] = (1.0 - swing) * np.array(k.load_asked)
        self.common[names["q_information"]] = q * (infomax.caution(spread) if info.criterion == "log_det" else 1.0)
        self.common[names["information_weight"]] = W.ravel()

    def _known_ahead(self) -> tuple[float, Array]:
        """Spread of the belief, and W of Tr(W F): worked out once for each guess and knowledge.

        W are the prior variances for `trace`; for `log_det` it is P after the horizon's F:

        d log det(P^-1 + sum F) = Tr(W dF) with W = (P^-1 + sum F)^-1, taken at the guess, F as much as the belief
        will count it for: taken in full, a moment of slip would seem to have taught all there is.
        """
        guess, k = self.sqp.z, self.knowledge
        if self._known is None or self._known[0] is not guess or self._known[1] is not k:
            W: Array = np.diag(k.prior_std**2)
            if self.settings.information.criterion == "log_det":
                F = infomax.independent_samples(self.settings.dt) * self.sqp.horizon_information(self.common)
                # (P^-1 + F)^-1 without inverting P, which may be singular
                W = np.asarray(np.linalg.solve(np.eye(len(k.mean)) + k.covariance @ F, k.covariance))
            self._known = guess, k, k.spread, W
        return self._known[2:]

    @property
    def clearance(self) -> float:
        """Least distance of the car's centre from the edges of the track, m."""
        limits = self.settings.limits
        return limits.car_half_width + limits.track_margin + limits.exploring_margin * self.problem.informative

    def brake_balance(self, z: Array, drive: float) -> float | None:
        """Of a command `drive` in state `z` (NZ,); None where the model knows no front brakes."""
        if not self._brakes_in_front:
            return None
        vx, yaw_rate, s = float(z[VX]), float(z[YAW_RATE]), float(z[S])
        extra = extra_load(self.reference.road_load(s), vx, yaw_rate)
        return float(self.settings.brakes.balance(vx, drive, self.knowledge.brake_ratio, extra))

    def take_sent(self, acting: Array, late: Late) -> None:
        """`acting` (2, N+1): drive and steer at each stage by what is sent already; what is decided now acts so `late`
        after the plan's start."""
        names, dt = self.problem.stage, self.settings.dt
        free = np.clip(np.arange(1, self.settings.horizon + 1) - np.array(late)[:, None] / dt, 0.0, 1.0)
        self.stages[names["sent"]], self.stages[names["free"]] = np.diff(acting), free
        drive = acting[0]
        self._within_reach = drive[1:] - drive[0] - self.settings.limits.drive_rate * dt * np.cumsum(free[0])

    def fill_stages(self, drive: float) -> None:
        """Stage parameters along the guess, at the present drive command."""
        self._fill_along_guess()
        self.stages[self.problem.stage["drive_max"]] = self._drive_max(self.sqp.z[VX, 1:], drive)

    @property
    def here(self) -> Array:
        """Parameters of the plan's first stage, all of whose inputs are free."""
        column = self.stages[:, 0].copy()
        column[self.problem.stage["sent"]], column[self.problem.stage["free"]] = 0.0, 1.0
        return column

    def _fill_along_guess(self) -> None:
        """Those that the guess alone decides, if not done yet."""
        along = self.sqp.z, self.reference, self.phi_at
        if self._filled is not None and all(a is b for a, b in zip(self._filled, along, strict=True)):
            return
        names, p, s = self.problem.stage, self.stages, along[0][S, 1:]
        knot, cubics, road = self.reference.stages(s)
        p[names["s"]] = knot
        p[names["cubic_x"]], p[names["cubic_y"]] = cubics[:4], cubics[4:]
        p[names["centre"]] = road[:2]
        p[names["half_width"]] = np.maximum(road[2] + road[3] * (s - knot) - self.clearance, MIN_CORRIDOR)
        p[names["speed"]] = road[4:6]
        p[names["grade"]], p[names["bank"]] = road[6:8] * self.road_share[:, None]
        p[names["road_load"]] = road[9:12] * np.array([[1.0], *self.road_share[:, None]])
        if self.problem.model.effects:
            p[names["phi"]] = self.phi_at(road[8])
        self._filled = along

    def _drive_max(self, vx: Array, drive: float) -> Array:
        """Upper drive limit of each stage, 1: engine power at the predicted speed, within reach from `drive`."""
        limits = self.settings.limits
        power = limits.power / (self.knowledge.theta[0] * np.maximum(vx, MIN_POWER_SPEED))
        return np.asarray(np.maximum(np.minimum(power, limits.drive_max), drive + self._within_reach))

    def solve(
        self, z0: Array, stopwatch: Stopwatch, iterations: int | None = None, *, explore: float = 1.0
    ) -> Solution:  # fmt: skip
        """Solution from state `z0` (NZ,), warm-started from the held guess, with the share `explore` of q_I."""
        self.fill_stages(float(z0[DRIVE]))
        self._weigh_information(float(z0[VX]), explore)
        return self.sqp.solve(z0, self.stages, self.common, iterations or self.settings.iterations, stopwatch)

    def shift(self) -> None:
        """Move the guess one interval on."""
        self.sqp.shift(self.stages[:, -1], self.common)

    def prepare(self) -> None:
        """What the next solve starts from as far as it does not depend on its state: an interval on, with parameters.

        Preparation phase of the real-time iteration (Diehl et al. 2005).
        """
        self.shift()
        self._fill_along_guess()
        if self.problem.informative:
            self._known_ahead()

    def cold_start(self, z0: Array, stopwatch: Stopwatch) -> Solution:
        """Solve without a previous solution: a guess along the reference, iterated."""
        self.sqp.set_guess(self._along_reference(z0), np.zeros((NU, self.settings.horizon)))
        solution = self.solve(z0, stopwatch, 1)
        for _ in range(COLD_START_ITERATIONS - 1):
            if not solution.usable:
                break
            solution = self.solve(z0, stopwatch, 1)
        return solution

    def advance(self, car: Car, held: list[Held]) -> Car:
        """The car after steps with inputs held, by the model of the plan."""
        start, steps, stages, common = self._advance.inputs
        stages[:], common[:] = self.stages[:, :1], self.common[:, None]
        for first in range(0, len(held), ADVANCE_STEPS):
            part = held[first : first + ADVANCE_STEPS]
            start[:, 0] = car
            steps.T[:] = part + [STILL] * (ADVANCE_STEPS - len(part))
            self._advance()
            car = tuple(self._advance.outputs[0][:, -1].tolist())
        return car

    def _along_reference(self, z0: Array) -> Array:
        """Trajectory (NZ, N+1) on the reference from the progress and speed of `z0`, gently towards the speed limit."""
        n, dt = self.settings.horizon, self.settings.dt
        z = np.repeat(z0[:, None], n + 1, axis=1)
        speed = max(float(z0[VX]), 1.0)
        for k in range(n):
            limit = float(self.reference.speed_limit(np.array([z[S, k]]))[0])
            speed += float(np.clip(limit - speed, -6.0 * dt, 3.0 * dt))
            z[S, k + 1], z[VX, k + 1] = z[S, k] + speed * dt, speed
        point = self.reference.at(z[S, 1:])
        z[0, 1:], z[1, 1:] = point.x, point.y
        heading = np.unwrap(np.concatenate([[z0[2]], point.heading]))
        z[2, 1:] = heading[1:]
        z[5, 1:] = point.curvature * z[VX, 1:]
        z[8, 1:] = np.clip(np.arctan(point.curvature * self.problem.model.vehicle.wheelbase), -0.25, 0.25)
        z[4, 1:] = 0.0
        z[PROGRESS, 1:] = z[VX, 1:]
        return z
