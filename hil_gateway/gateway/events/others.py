"""What the other processes do, by their messages: which have fallen silent, what they learnt and adopted."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from hil_gateway.bus.event import EventKind, Severity
from hil_gateway.bus.interface import Bus, LatestReader
from hil_gateway.bus.latest import Latest
from hil_gateway.bus.messages import Alert, ModelRevision, Plan, PlanStatus
from hil_gateway.bus.proposal import ModelProposal, Outcome
from hil_gateway.bus.topics import (
    ALERT,
    BELIEF,
    MODEL_PROPOSAL,
    MODEL_REVISION,
    RECEIVER_STATUS,
    RECORDER_STATUS,
    Topic,
)
from hil_gateway.gateway.events.change import Change
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.process.figures import figure

QUIET_S = 1.0
"""a process whose messages are older than this, or than their own deadline, is worth an entry: a single late message is
left to the failsafe"""
WATCHED: dict[str, Topic[Any]] = {"estimator": BELIEF, "recorder": RECORDER_STATUS}
"""beside the planner, whose plans the gateway reads anyway"""
LOOK_NS = NS_PER_S // 10
"""between two looks at what comes seldom; a new plan is looked at once"""
QUEUE = 8
REFINED_NS = 60 * NS_PER_S
"""tyres are refined every few seconds while driving: one entry a minute is enough"""


class OtherProcesses:
    """Watches what passes on the bus; `step` gives the changes since the last call."""

    def __init__(self, bus: Bus) -> None:
        self._readers = {name: LatestReader(bus, topic) for name, topic in WATCHED.items()}
        self._alive: set[str] = set()
        self._plans = self._due_ns = 0
        self._revisions = LatestReader(bus, MODEL_REVISION)
        self._alerts = bus.subscribe(ALERT, depth=QUEUE)
        self._proposals = bus.subscribe(MODEL_PROPOSAL, depth=QUEUE)
        self._receivers = LatestReader(bus, RECEIVER_STATUS)
        self._causes: dict[str, str] = {}
        """receiver -> why it does not place the car; empty: it does"""
        self._published, self._adopted = _Models(), _Models()
        self._effects: dict[str, str] = {}
        self._lap: tuple[int, int | None] | None = None
        self._began_m = 0.0
        """progress of the plan where its count of laps was first seen, m"""
        self._stands = False

    def step(self, now_ns: int, planned: Latest[Plan]) -> Iterator[Change]:
        """Changes since the last call; `planned` as the gateway has read it."""
        if now_ns < self._due_ns and planned.count == self._plans:
            return
        self._due_ns, self._plans = now_ns + LOOK_NS, planned.count
        for name, reader in self._readers.items():
            yield from self._presence(name, reader.update(now_ns), now_ns)
        yield from self._presence("planner", planned, now_ns)
        yield from self._receiving(now_ns)
        for alert in self._alerts.poll(now_ns):
            yield _alert(alert)
        for proposal in self._proposals.poll(now_ns):
            yield _proposal(proposal)
        revision = self._revisions.update(now_ns).message
        if revision is not None and revision.revision != self._published.revision:
            self._effects = {self._published.revision: self._published.effects, revision.revision: _effects(revision)}
            before = self._published.revision
            if self._published.note(now_ns, revision.revision, _effects(revision)):
                yield _published(before, revision)
        if planned.message is not None:
            yield from self._plan(now_ns, planned.message)

    def _presence(self, name: str, latest: Latest[Any], now_ns: int) -> Iterator[Change]:
        age_s, limit_s = latest.age_s(now_ns), max(latest.deadline_s, QUIET_S)
        alive = age_s <= limit_s
        if alive != (name in self._alive):
            self._alive ^= {name}
            yield _appeared(name) if alive else _quiet(name, age_s, limit_s)

    def _receiving(self, now_ns: int) -> Iterator[Change]:
        """Receivers on the network that place the car again, or do so no longer."""
        status = self._receivers.update(now_ns).message
        for name, health in ({} if status is None else status.receivers).items():
            before, self._causes[name] = self._causes.get(name), health.cause
            if health.cause != before:
                yield _receiver(name, before, health.cause)

    def _plan(self, now_ns: int, plan: Plan) -> Iterator[Change]:
        """A model taken into use, a lap begun, a car that goes on standing."""
        if (plan.status is PlanStatus.NOT_MOVING) != self._stands:
            self._stands = not self._stands
            yield _standing(plan) if self._stands else _driving_off()
        before = self._adopted.revision
        if plan.revision != before:
            effects = self._effects.get(plan.revision, self._adopted.effects)
            if self._adopted.note(now_ns, plan.revision, effects):
                text = f"the planner drives with this model: {effects or 'its start model'}"
                yield Change(EventKind.ADOPTION, before, plan.revision, text)
        started_ns = plan.state_stamp_ns
        if self._lap is None or plan.lap < self._lap[0]:
            self._lap, self._began_m = (plan.lap, None), plan.s[0]
        elif plan.lap > self._lap[0]:
            yield _lap_done(self._lap[0], plan.lap, self._lap[1], started_ns, plan.s[0] - self._began_m)
            self._lap = plan.lap, started_ns


def _standing(plan: Plan) -> Change:
    return Change(EventKind.PLAN, "", "not moving", plan.reason, Severity.WARNING)


def _driving_off() -> Change:
    return Change(EventKind.PLAN, "not moving", "moving", "the plan drives off")


def _lap_done(before: int, after: int, began_ns: int | None, now_ns: int, way_m: float) -> Change:
    """A lap by the plan's count; its time only where it began at the line."""
    if began_ns is None:
        text = f"the line after {way_m:.0f} m: lap {after} did not begin there"
        return Change(EventKind.LAP, str(before), str(after), text)
    lap_s, text = (now_ns - began_ns) / NS_PER_S, f"lap {after} done, timed to 0.05 s"
    return Change(EventKind.LAP, str(before), str(after), text, measured=lap_s, unit="s")


class _Models:
    """Which model is in use; a change of tyres alone is noted once in `REFINED_NS`."""

    def __init__(self) -> None:
        self.revision, self.effects, self._noted_ns = "", "", -REFINED_NS

    def note(self, now_ns: int, revision: str, effects: str) -> bool:
        """Whether this change is worth an entry."""
        worth = effects != self.effects or now_ns - self._noted_ns >= REFINED_NS
        self.revision, self.effects = revision, effects
        self._noted_ns = now_ns if worth else self._noted_ns
        return worth


def _appeared(name: str) -> Change:
    return Change(EventKind.PROCESS, "", f"{name} speaks", f"first messages of the {name}")


def _quiet(name: str, age_s: float, limit_s: float) -> Change:
    text = f"no message of the {name}: ended, hung or cut off"
    after = f"{name} silent"
    return Change(EventKind.PROCESS, f"{name} speaks", after, text, Severity.WARNING, "", age_s, limit_s, "s")


def _receiver(name: str, before: str | None, cause: str) -> Change:
    severity = Severity.WARNING if cause else Severity.INFO
    was = "" if before is None else before or "places the car"
    return Change(EventKind.RECEIVER, was, cause or "places the car", f"receiver {name}", severity)


def _alert(alert: Alert) -> Change:
    suspect = f"; suspected effect {alert.suspected_effect}" if alert.suspected_effect else ""
    text = f"the model does not explain {alert.channel} in {alert.condition}{suspect}: residual over its noise"
    return Change(
        EventKind.ALERT, "", alert.channel, text, Severity.WARNING, alert.suspected_effect, alert.strength, unit="times"
    )


def _proposal(proposal: ModelProposal) -> Change:
    """What the learner makes of the laps so far."""
    severity = Severity.WARNING if proposal.outcome is Outcome.WITHDRAWN else Severity.INFO
    found = f"{', '.join(proposal.effects)}: " if proposal.effects else ""
    text = f"after lap {proposal.lap}: {found}{proposal.reason}"
    return Change(EventKind.LEARNING, "", proposal.outcome, text, severity)


def _published(before: str, revision: ModelRevision) -> Change:
    tyres = ", ".join(f"{name} {figure(value)}" for name, value in revision.tyre.items())
    note = f" ({revision.provenance.note})" if revision.provenance.note else ""
    return Change(EventKind.REVISION, before, revision.revision, f"{_effects(revision)}; {tyres}{note}")


def _effects(revision: ModelRevision) -> str:
    return ", ".join(effect.name for effect in revision.effects) or "no effects added"
