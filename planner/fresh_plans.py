"""Fresh plans of the solver: a guess carried on, solved, judged; explored less where tyres are near their limits."""

from __future__ import annotations

import math

from hil_gateway.bus.messages import PlanStatus
from hil_gateway.config import PlannerConfig
from hil_gateway.gateway.perceive.road_speed import STANDSTILL
from hil_gateway.process.arrays import Array
from hil_gateway.process.clock import NS_PER_S
from planner.adoption.adoption import Adoption
from planner.plan.checks import PlanCheck
from planner.plan.fallback import Trajectory
from planner.plan.from_rest import moves_off
from planner.plan.publishing import PlanDecision
from planner.problem.load_limits import LoadLimits, SustainedLoad
from planner.problem.motion import VX
from planner.problem.settings import Settings
from planner.solver.sqp import Solution, Stopwatch

EXTRA = (1.0, 1.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0)
"""share of q_I kept in each SQP iteration more for a plan that is not accepted or loads a tyre beyond `OVERLOAD`: where
tyres are near their peak, full steps go to and fro, and half steps need some"""
TIMID, BOLDER = 0.5, 0.025
"""share of q_I: times the one where a tyre already is at more than `OVERLOAD` of its limit, so that the car slides more
than was planned; plus the other after every other plan"""
OVERLOAD = 1.02
COLD_GAP_S = 0.3
COLD_DISTANCE = 5.0
"""a state this far (m) from the plan, or a guess this old, starts the solver afresh: the car has been moved"""


class FreshPlans:
    """One solver, which begins where its last plan ended."""

    def __init__(self, config: PlannerConfig, settings: Settings, adoption: Adoption, stopwatch: Stopwatch) -> None:
        self._config, self._dt, self._adoption, self._stopwatch = config, settings.dt, adoption, stopwatch
        self.check = PlanCheck(settings)
        self._held = (SustainedLoad(settings.dt), SustainedLoad(settings.dt))
        self.boldness = 0.0
        """share of q_I"""
        self.guess_start_ns: int | None = None
        self.solved_ns = 0
        """start of the newest plan that was accepted"""

    def carry_on(self) -> None:
        """Take a guess that is as old as the last plan an interval on."""
        if self.guess_start_ns is not None and self.guess_start_ns == self.solved_ns:
            self._adoption.controller.prepare()
            self.guess_start_ns += round(self._dt * NS_PER_S)

    def forget(self) -> None:
        """What is planned next begins afresh."""
        self.guess_start_ns, self.solved_ns = None, 0

    def solve(self, z0: Array, start_ns: int, started: int, expected: Array | None) -> PlanDecision | str:
        """Fresh plan, or the reason there is none; `expected`: state that the last plan has there."""
        controller = self._adoption.controller
        if self._is_cold(z0, start_ns, expected):
            solution = controller.cold_start(z0, self._stopwatch)
        else:
            for _ in range(self._intervals_since(start_ns)):
                controller.shift()
            solution = controller.solve(z0, self._stopwatch, explore=self.boldness)
        found = self._judge(solution)
        for number, kept in enumerate(EXTRA):
            # another iteration straightens out a far stage beyond a curved limit; where exploring led there, less of it
            if not (found or self._overreaches()) or not solution.usable or self._late(started):
                break
            self.boldness *= kept
            if number > 0:
                controller.sqp.halve_step()
            solution = controller.solve(z0, self._stopwatch, 1, explore=self.boldness)
            found = self._judge(solution)
        self.guess_start_ns = start_ns if solution.usable else None
        if found:
            return found
        if self._late(started):
            return f"solver: later than {1e3 * self._config.deadline_s:.0f} ms"
        self.solved_ns = start_ns
        if self._adoption.corrected:
            self._note_loads()
        overloaded = max(self.check.first_loads) > OVERLOAD
        self.boldness = TIMID * self.boldness if overloaded else min(1.0, self.boldness + BOLDER)
        return PlanDecision(
            Trajectory(solution.z, solution.du, start_ns), PlanStatus.SOLVED, gain=float(solution.information.sum())
        )

    def _judge(self, solution: Solution) -> str:
        """Why a solution must not be published; empty when it may."""
        if not solution.usable:
            return f"solver: {solution.status.value}"
        found = self.check(self._adoption.controller, self._adoption.current.revised, solution)
        return f"not accepted: {'; '.join(found)}" if found else ""

    def _overreaches(self) -> bool:
        """Whether a plan that could explore less uses what acceptance leaves for disturbances."""
        return self.boldness > 0.0 and self.check.worst_load > max(OVERLOAD, *self.check.first_loads)

    def _late(self, started: int) -> bool:
        return (self._stopwatch() - started) / NS_PER_S > self._config.deadline_s

    def _note_loads(self) -> None:
        limits, most = self._adoption.controller.knowledge.load_max, 1.0 / self._config.load_use
        # across alone: a start from rest says nothing of bends; the share of a sliding tyre goes on beyond its
        # peak, what it bears does not
        for held, share, limit in zip(self._held, self.check.first_across, limits, strict=True):
            held.push(min(share, most) * limit)
        before = self._adoption.sustained
        self._adoption.sustained = LoadLimits(
            max(before.front, self._held[0].value), max(before.rear, self._held[1].value)
        )  # fmt: skip

    def _intervals_since(self, start_ns: int) -> int:
        assert self.guess_start_ns is not None
        return max(0, round((start_ns - self.guess_start_ns) / (self._dt * NS_PER_S)))

    def _is_cold(self, z0: Array, start_ns: int, expected: Array | None) -> bool:
        if self.guess_start_ns is None or start_ns - self.guess_start_ns > COLD_GAP_S * NS_PER_S:
            return True
        # at rest under the brakes the motion has no slope over the drive command: a guess that stands says nothing
        if z0[VX] < STANDSTILL and not moves_off(self._adoption.controller.sqp.z, self._dt):
            return True
        return expected is None or distance(expected, z0) > COLD_DISTANCE


def distance(a: Array, b: Array) -> float:
    """Between the places of two states (NZ,), m."""
    return math.hypot(a[0] - b[0], a[1] - b[1])
