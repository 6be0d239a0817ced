"""From a decided trajectory to messages: the command that leads the actuators' lag, then the plan for whoever looks on.

The command is what counts: it leaves before the plan is put together.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hil_gateway.bus import topics
from hil_gateway.bus.interface import Bus
from hil_gateway.bus.messages import Agreement, Command, Plan, PlanStatus
from hil_gateway.config import Config
from hil_gateway.process.arrays import Array
from planner.plan.controller import Controller
from planner.plan.fallback import Trajectory
from planner.plan.prediction import AT_ONCE, ActuatorModel, Late
from planner.problem.motion import DRIVE, STATES, STEER, S
from planner.problem.settings import Settings

PUBLISHED = {name: STATES.index(name) for name in ("x", "y", "yaw", "vx", "s", "steer", "drive")}
"""rows of the states that a plan message has"""


@dataclass(frozen=True)
class PlanDecision:
    """What to publish: a full trajectory, how it came about, and the information it gains (Eq. 7)."""

    plan: Trajectory
    status: PlanStatus
    reason: str = ""
    gain: float = 0.0


@dataclass(frozen=True)
class InForce:
    """Controller that plans, the revision of its model, the drive command to send for one by its force, and how much
    later than reported inputs act."""

    controller: Controller
    revision: str
    sent: Callable[[float], float]
    late: Late = AT_ONCE


@dataclass(frozen=True)
class Stamps:
    """Time and number of both messages, and the stamp of the vehicle state they answer."""

    stamp_ns: int
    seq: int
    state_stamp_ns: int


class Publisher:
    """Publishes decisions of one planner."""

    def __init__(
        self, config: Config, bus: Bus, actuators: ActuatorModel, settings: Settings, agreement: Agreement
    ) -> None:
        self._agreement = agreement
        self._bus, self._actuators, self._settings, self._train = bus, actuators, settings, config.powertrain

    def __call__(self, decision: PlanDecision, model: InForce, stamps: Stamps, took_ns: Callable[[], int]) -> Plan:
        """Command, then the plan, with how long it took until then; the plan."""
        z = decision.plan.z
        self._bus.publish(topics.COMMAND, self._command(z, model, stamps))
        rows = z.tolist()
        message = Plan(
            **vars(stamps), status=decision.status, reason=decision.reason, dt=self._settings.dt,
            **{name: rows[number] for name, number in PUBLISHED.items()},
            lap=max(0, int(z[S, 0] // model.controller.reference.length)),
            revision=model.revision, solve_ms=took_ns() / 1e6, information_gain=decision.gain,
            agreement=self._agreement,
        )  # fmt: skip
        self._bus.publish(topics.PLAN, message)
        return message

    def _command(self, z: Array, model: InForce, stamps: Stamps) -> Command:
        """That takes the actuators through an interval of states z (NZ, N+1) and their lag, from where they are when it
        begins to act."""
        actuators, limits, dt, train = self._actuators, self._settings.limits, self._settings.dt, self._train
        steer = actuators.lead(*_interval(z[STEER], model.late.steer / dt), dt, actuators.steer_lag)
        acts = model.late.drive / dt
        drive = actuators.lead(*_interval(z[DRIVE], acts), dt, actuators.drive_lag)
        drive = within(drive, limits.drive_min, limits.drive_max)
        return Command(
            **vars(stamps), source="planner", steer=within(steer, -limits.steer, limits.steer),
            drive=max(model.sent(drive), -train.hardest_braking / train.force_per_drive),
            brake_balance=model.controller.brake_balance(z[:, round(acts)], drive),
        )  # fmt: skip


def _interval(stages: Array, begins: float) -> tuple[float, float]:
    """Value of an input (N+1,) at this fraction of a stage, and a stage later."""
    now, then = np.interp((begins, begins + 1.0), np.arange(len(stages)), stages).tolist()
    return now, then


def within(value: float, low: float, high: float) -> float:
    """The value between two bounds that is nearest."""
    return min(max(value, low), high)
