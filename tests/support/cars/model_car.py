"""A car that moves exactly as the planner's model, with lagging actuators, and the estimator that sees it perfectly.

The planner behind its bus in closed loop without plant, gateway and estimator: ten times faster, and every
disturbance is the test's own.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from estimator.belief.revision import revision_id
from hil_gateway.bus import topics
from hil_gateway.bus.interface import LocalBus
from hil_gateway.bus.messages import ActiveEffect, Applied, Command, Estimate, FailsafeAction, ModelRevision, Plan
from hil_gateway.config import Config, load_config
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.track.track import Track
from planner.node import Planner
from planner.plan.prediction import ActuatorModel, Sent
from planner.solver.fixed import SolveOutcome
from planner.solver.qp import QpStatus
from planner.solver.sqp import Sqp, Stopwatch

TICK_NS = NS_PER_S // 100
PLAN_TICKS = 5
HORIZON = 40


class ModelCar:
    """Planner, car and bus on a virtual clock; `run` drives, `plans` and `commands` keep what was published."""

    def __init__(
        self, config: Config, track: Track | None = None, *, speed_share: float = 0.9,
        stopwatch: Stopwatch = lambda: 0, background: bool = False,
    ) -> None:  # fmt: skip
        self.bus = LocalBus()
        self.planner = Planner(config, self.bus, track, stopwatch=stopwatch, background=background)
        self._commands = self.bus.subscribe(topics.COMMAND, depth=4)
        self._actuators = ActuatorModel(config.car.actuators)
        controller = self.planner.adoption.controller
        # the car keeps its physics when the planner's model changes
        self._physics = controller.problem.held_step()
        self._common, self._stage = controller.common.copy(), controller.stages[:, 0].copy()
        if controller.problem.model.effects:
            self._stage[controller.problem.stage["phi"]] = controller.phi_at(np.zeros(1))[:, 0]
        point = controller.reference.at(np.zeros(1))
        speed = speed_share * float(controller.reference.speed_limit(np.zeros(1))[0])
        self.car: NDArray[np.float64] = np.array([point.x[0], point.y[0], point.heading[0], speed, 0.0, 0.0])
        self.drive = self.steer = 0.0
        self.now_ns = NS_PER_S
        self.plans: list[Plan] = []
        self.commands: list[Command] = []
        self.cars: list[NDArray[np.float64]] = []

    def estimate(self, **changes: object) -> Estimate:
        """What a perfect estimator says now."""
        x, y, yaw, vx, vy, yaw_rate = self.car.tolist()
        values = {
            "stamp_ns": self.now_ns, "seq": self.now_ns // TICK_NS, "state_stamp_ns": self.now_ns, "valid": True,
            "x": x, "y": y, "yaw": yaw, "vx": vx, "vy": vy, "yaw_rate": yaw_rate, "bias_ax": 0.0, "bias_ay": 0.0,
            "bias_yaw_rate": 0.0, "std": (0.1,) * 9, "steer": self.steer, "drive": self.drive,
            "innovations_rejected": 0,
        }  # fmt: skip
        return Estimate.model_construct(**{**values, **changes})

    def tick(self, estimate: Estimate | None) -> Plan | None:
        """10 ms; `estimate` None keeps the estimator silent. The plan, when one was due."""
        self.now_ns += TICK_NS
        if estimate is not None:
            self.bus.publish(topics.ESTIMATE, estimate)
        plan = None
        if (self.now_ns // TICK_NS) % PLAN_TICKS == 0 and (plan := self.planner.step(self.now_ns)) is not None:
            self.plans.append(plan)
        for command in self._commands.poll(self.now_ns):
            self.commands.append(command)
        if self.commands:
            self._send(self.commands[-1])
        duration = TICK_NS / NS_PER_S
        self.drive, self.steer = self._actuators.follow(self.drive, self.steer, self.now_ns, duration)
        held = np.array([self.drive, self.steer, duration])
        self.car = np.array(self._physics(self.car, held, self._stage, self._common)).ravel()
        self.cars.append(self.car.copy())
        return plan

    def run(self, seconds: float) -> None:
        """Drive undisturbed."""
        for _ in range(round(seconds * 100)):
            self.tick(self.estimate())

    def _send(self, command: Command) -> None:
        """The gateway: sends the newest command on and says so."""
        self._actuators.record(Sent(self.now_ns, command.steer, command.drive))
        self.bus.publish(topics.APPLIED, Applied(
            stamp_ns=self.now_ns, seq=self.now_ns // TICK_NS, sent=True, action=FailsafeAction.DRIVE, limited=(),
            steer=command.steer, drive=command.drive, accelerator_percent=0.0, brake_front_kpa=0.0,
            brake_rear_kpa=0.0, steering_motor_deg=0.0, gear=1,
        ))  # fmt: skip


def planner_config(**overrides: object) -> Config:
    return load_config(None, {f"planner.{name}": value for name, value in overrides.items()})


def whole(plan: Plan) -> bool:
    """Every array of a plan has the full horizon and only finite numbers."""
    arrays = [getattr(plan, name) for name in ("x", "y", "yaw", "vx", "s", "steer", "drive")]
    return all(len(a) == HORIZON + 1 and np.isfinite(a).all() for a in arrays)


def assert_within_limits(rig: ModelCar) -> None:
    """Commands and plans keep to the actuators' ranges and rates, whatever their status."""
    limits = rig.planner.settings.limits
    for command in rig.commands:
        assert abs(command.steer) <= limits.steer
        assert limits.drive_min <= command.drive <= limits.drive_max
    for plan in rig.plans:
        assert whole(plan)
        assert np.abs(plan.steer).max() <= limits.steer + 1e-4
        assert np.abs(np.diff(plan.steer)).max() <= limits.steer_rate * plan.dt * 1.001 + 1e-5
        assert np.abs(np.diff(plan.drive)).max() <= limits.drive_rate * plan.dt * 1.001 + 1e-5
        assert min(plan.vx) > -0.5


def revision_with(rig: ModelCar, tyre: dict[str, float] | None = None, *effects: ActiveEffect) -> ModelRevision:
    """The revision in force with changed tyre parameters and, where some are given, other effects."""
    current = rig.planner.adoption.current.revision
    effects = effects or current.effects
    values = {**current.tyre, **(tyre or {})}
    return current.model_copy(
        update={"tyre": values, "effects": effects, "revision": revision_id(current.layout, values, effects)}
    )


def fail_solvers(monkeypatch: pytest.MonkeyPatch, sqp: Sqp, status: Callable[[], QpStatus | None]) -> None:
    """Every solver of `sqp` ends with `status()`; where that is None, it solves."""
    real, generated = sqp._solver.solve, sqp._fixed
    monkeypatch.setattr(sqp._solver, "solve", lambda: status() or real())
    if generated is None:
        return
    iterate = generated.iterate

    def forced(iterations: int) -> SolveOutcome:
        found = status()
        return SolveOutcome(found, 0, 0, 0, 0, 0.0) if found else iterate(iterations)

    monkeypatch.setattr(generated, "iterate", forced)
