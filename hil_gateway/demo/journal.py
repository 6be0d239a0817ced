"""The event log of a run, and what became of every model revision, gathered for the summary."""

from __future__ import annotations

from collections import deque
from typing import Any

from hil_gateway.bus.event import Event, EventKind, Severity
from hil_gateway.bus.interface import Bus
from hil_gateway.bus.messages import ModelRevision, Plan
from hil_gateway.bus.proposal import ModelProposal, Outcome
from hil_gateway.bus.topics import EVENT, MODEL_PROPOSAL, MODEL_REVISION
from hil_gateway.process.clock import NS_PER_S

MOST = 10_000
"""entries kept: a day of ordinary driving; the oldest go first"""
QUEUE = 256
NEWS = 10
"""lines of news at once, of the newest"""


class Journal:
    """What the gateway logs and what the demo itself notes, in one list; `update` at any rate."""

    def __init__(self, bus: Bus) -> None:
        self._events = bus.subscribe(EVENT, depth=QUEUE)
        self._revisions = bus.subscribe(MODEL_REVISION, depth=QUEUE)
        self._proposals = bus.subscribe(MODEL_PROPOSAL, depth=QUEUE)
        self.events: deque[Event] = deque(maxlen=MOST)
        self._models: list[tuple[int, dict[str, Any]]] = []
        self._row_of: dict[str, dict[str, Any]] = {}
        """revision -> its row: values that are refined while driving make no row of their own"""
        self._laps = 0
        self._news: deque[str] = deque(maxlen=NEWS)
        self._driven_with = ""

    def update(self, now_ns: int, plan: Plan | None) -> None:
        """Take in what has arrived; `plan` is the newest one."""
        for event in self._events.poll(now_ns):
            self.events.append(event)
            self._tell(event)
        self._laps = plan.lap if plan else self._laps
        for proposal in self._proposals.poll(now_ns):
            self._note_outcome(proposal)
        for revision in self._revisions.poll(now_ns):
            self._note(revision)
        if plan and (row := self._row_of.get(plan.revision)) is not None:
            row["adopted"] = True

    def _tell(self, event: Event) -> None:
        """Note what is news: outcomes of the learner, and another list of effects driven with."""
        if event.kind is EventKind.LEARNING or (event.kind is EventKind.ADOPTION and event.text != self._driven_with):
            self._news.append(event.line())
        self._driven_with = event.text if event.kind is EventKind.ADOPTION else self._driven_with

    def news(self) -> list[str]:
        """What was learnt or adopted since the last call, one line each."""
        told = list(self._news)
        self._news.clear()
        return told

    def say(self, text: str, now_ns: int) -> None:
        """An entry of the demo itself: a process ended, the car stands."""
        kind, severity = EventKind.PROCESS, Severity.INFO
        self.events.append(
            Event(stamp_ns=now_ns, seq=0, kind=kind, severity=severity, before="", after="demo", text=text)
        )

    def entries(self, zero_ns: int) -> list[dict[str, Any]]:
        """Events for the summary, by time; `t` in s after `zero_ns`."""
        return [event.entry(zero_ns) for event in sorted(self.events, key=lambda event: event.stamp_ns)]

    def revisions(self, zero_ns: int) -> list[dict[str, Any]]:
        """Every list of effects: when, in which lap, whether the planner took it, and why or why not."""
        return [{"t": _seconds(stamp_ns, zero_ns), **row} for stamp_ns, row in self._models]

    def _note_outcome(self, proposal: ModelProposal) -> None:
        """What was found and not proposed, and what was withdrawn; a proposal itself becomes a revision."""
        if proposal.outcome in (Outcome.KEPT, Outcome.WITHDRAWN) and len(self._models) < MOST:
            reason = f"{proposal.outcome}: {proposal.reason}"
            self._models.append((proposal.stamp_ns, _row(proposal.lap, "", list(proposal.effects), reason)))

    def _note(self, revision: ModelRevision) -> None:
        """A new list of effects is a row; the same one with other values belongs to the row it has."""
        if revision.revision in self._row_of or len(self._row_of) >= MOST:
            return
        effects = [effect.name for effect in revision.effects]
        row = next(reversed(self._row_of.values()), None)
        if row is None or row["effects"] != effects:
            row = _row(self._laps, revision.revision, effects, revision.provenance.note)
            self._models.append((revision.stamp_ns, row))
        self._row_of[revision.revision] = row


def _row(lap: int, revision: str, effects: list[str], reason: str) -> dict[str, Any]:
    return {"lap": lap, "revision": revision, "effects": effects, "adopted": False, "reason": reason}


def _seconds(stamp_ns: int, zero_ns: int) -> float:
    return round((stamp_ns - zero_ns) / NS_PER_S, 3)
