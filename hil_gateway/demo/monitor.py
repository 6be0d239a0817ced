"""What the demo knows of the running loop, by listening to the bus."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from hil_gateway.bus.interface import Bus, LatestReader
from hil_gateway.bus.messages import (
    Belief,
    Estimate,
    FailsafeAction,
    GatewayStatus,
    Plan,
    RecorderStatus,
)
from hil_gateway.bus.topics import (
    BELIEF,
    COMMAND,
    ESTIMATE,
    GATEWAY_STATUS,
    MODEL_REVISION,
    PLAN,
    RECORDER_STATUS,
    Topic,
)
from hil_gateway.demo.journal import Journal
from hil_gateway.gateway.decide.arming import DRIVES_OFF

WATCHED: tuple[Topic[Any], ...] = (
    GATEWAY_STATUS,
    ESTIMATE,
    BELIEF,
    MODEL_REVISION,
    PLAN,
    COMMAND,
)
"""topics whose age is shown; of the gateway its status alone: what it says 100 times a second is not sent here, too"""
REASONS_MAX = 64
"""kinds of failure told apart; the planner has a dozen"""
STOPS_MAX = 1000
"""stops listed in a summary"""
STOPS = (FailsafeAction.CONTROLLED_STOP, FailsafeAction.EMERGENCY_STOP)


@dataclass(frozen=True)
class ObservedFailsafe:
    """The gateway stopped the car."""

    t_s: float
    action: str
    cause: str
    detail: str = ""
    """who was late, where lateness was the cause"""


@dataclass
class PlanCount:
    """Every plan since the car was first under way."""

    solve_ms: list[float] = field(default_factory=list)
    failures: int = 0
    reasons: dict[str, int] = field(default_factory=dict)

    def add(self, plan: Plan) -> None:
        """Count one plan."""
        self.solve_ms.append(plan.solve_ms)
        if plan.status not in DRIVES_OFF:
            self.failures += 1
            kind = ":".join((plan.reason or plan.status).split(":")[:2])  # without the figures of this plan
            if kind in self.reasons or len(self.reasons) < REASONS_MAX:
                self.reasons[kind] = self.reasons.get(kind, 0) + 1


class Monitor:
    """Newest message of every watched topic, plan statistics and failsafe events."""

    def __init__(self, bus: Bus) -> None:
        self._readers = {topic.key: LatestReader(bus, topic) for topic in WATCHED if topic is not PLAN}
        self._plan_queue = bus.subscribe(PLAN, depth=64)
        self._recorder = LatestReader(bus, RECORDER_STATUS)
        self._plan_received_ns: int | None = None
        self._started_ns: int | None = None
        self._action = FailsafeAction.SILENT
        self.plan: Plan | None = None
        self.plans = PlanCount()
        self.journal = Journal(bus)
        self.failsafes: list[ObservedFailsafe] = []
        self.prior: Belief | None = None

    def update(self, now_ns: int, driving: bool) -> None:
        """Take in what has arrived; plans and stops count while `driving`."""
        for reader in self._readers.values():
            reader.update(now_ns)
        self._recorder.update(now_ns)
        for plan in self._plan_queue.poll(now_ns):
            self.plan, self._plan_received_ns = plan, now_ns
            if driving and not self.failsafes:
                self.plans.add(plan)
        self.journal.update(now_ns, self.plan)
        self.prior = self.prior or self.belief
        if driving:
            self._note_failsafe(now_ns)

    def _note_failsafe(self, now_ns: int) -> None:
        if self._started_ns is None:
            self._started_ns = now_ns
        status = self.status
        if status is None or status.action is self._action:
            return
        self._action = status.action
        if status.action in STOPS and len(self.failsafes) < STOPS_MAX:
            t_s = (now_ns - self._started_ns) / 1e9
            self.failsafes.append(ObservedFailsafe(t_s, status.action.value, status.cause, status.detail))

    def _message(self, topic: Topic[Any]) -> Any:
        return self._readers[topic.key].latest.message

    @property
    def status(self) -> GatewayStatus | None:
        """Newest gateway status."""
        status: GatewayStatus | None = self._message(GATEWAY_STATUS)
        return status

    @property
    def estimate(self) -> Estimate | None:
        """Newest estimate."""
        estimate: Estimate | None = self._message(ESTIMATE)
        return estimate

    @property
    def belief(self) -> Belief | None:
        """Newest belief."""
        belief: Belief | None = self._message(BELIEF)
        return belief

    @property
    def recorder(self) -> RecorderStatus | None:
        """Newest recorder status."""
        return self._recorder.latest.message

    def speaking(self, now_ns: int) -> set[str]:
        """Processes of the loop whose messages are fresh."""
        alive = {key for key, (_, alive) in self.ages_s(now_ns).items() if alive}
        alive |= {RECORDER_STATUS.key} if self._recorder.latest.alive(now_ns) else set()
        return {topic.publisher for topic in (GATEWAY_STATUS, ESTIMATE, PLAN, RECORDER_STATUS) if topic.key in alive}

    def ages_s(self, now_ns: int) -> dict[str, tuple[float, bool]]:
        """Topic -> (age in s, still within its deadline)."""
        ages = {key: (r.latest.age_s(now_ns), r.latest.alive(now_ns)) for key, r in self._readers.items()}
        if self._plan_received_ns is not None:
            age = (now_ns - self._plan_received_ns) / 1e9
            ages[PLAN.key] = (age, age <= PLAN.deadline_s)
        return ages
