"""What became of every model of a run: found or not, driven with or not, and why."""

from __future__ import annotations

from typing import Any

from hil_gateway.bus import topics
from hil_gateway.bus.event import Event, EventKind, Severity
from hil_gateway.bus.interface import LocalBus
from hil_gateway.bus.messages import ActiveEffect, ModelRevision, Plan, PlanStatus, Provenance
from hil_gateway.bus.proposal import ModelProposal, Outcome
from hil_gateway.demo.journal import NEWS, Journal
from hil_gateway.process.clock import NS_PER_S

ROWS: dict[str, Any] = dict.fromkeys(("x", "y", "yaw", "vx", "s", "steer", "drive"), (0.0,))


def plan(revision: str, lap: int) -> Plan:
    return Plan(
        stamp_ns=1, seq=1, state_stamp_ns=1, status=PlanStatus.SOLVED, dt=0.05, lap=lap, revision=revision,
        solve_ms=1.0, **ROWS,
    )  # fmt: skip


def revision(name: str, effects: tuple[str, ...], note: str = "") -> ModelRevision:
    active = tuple(ActiveEffect(name=effect, parameters={}) for effect in effects)
    return ModelRevision(
        stamp_ns=4 * NS_PER_S, seq=1, revision=name, layout="shared", tyre={"cx": 1.0}, effects=active,
        provenance=Provenance(note=note),
    )  # fmt: skip


def outcome(seq: int, kind: Outcome, reason: str) -> ModelProposal:
    return ModelProposal(stamp_ns=3 * NS_PER_S, seq=seq, outcome=kind, lap=3, effects=("aero_drag",), reason=reason)


def test_every_model_has_a_row_with_what_became_of_it_and_why() -> None:
    bus = LocalBus()
    journal = Journal(bus)
    for seq, (kind, reason) in enumerate([
        (Outcome.STARTED, "laps 1 to 3"), (Outcome.KEPT, "vy is worse"), (Outcome.PROPOSED, "better"),
        (Outcome.WITHDRAWN, "the first lap was slower"),
    ]):  # fmt: skip
        bus.publish(topics.MODEL_PROPOSAL, outcome(seq, kind, reason))
    bus.publish(topics.MODEL_REVISION, revision("a", (), "declared"))
    bus.publish(topics.MODEL_REVISION, revision("b", ("aero_drag",), "aero_drag: found while driving"))
    journal.update(0, plan("b", 4))
    rows = {row["reason"]: row for row in journal.revisions(NS_PER_S)}
    assert list(rows) == [
        "kept: vy is worse", "withdrawn: the first lap was slower", "declared", "aero_drag: found while driving"
    ]  # fmt: skip
    adopted = rows["aero_drag: found while driving"]
    assert (adopted["adopted"], adopted["effects"], adopted["lap"], adopted["t"]) == (True, ["aero_drag"], 4, 3.0)
    kept = rows["kept: vy is worse"]
    assert (kept["adopted"], kept["effects"], kept["lap"], kept["t"]) == (False, ["aero_drag"], 3, 2.0)


def test_values_refined_while_driving_make_no_row_and_count_as_the_model_they_belong_to() -> None:
    bus = LocalBus()
    journal = Journal(bus)
    for name, effects in (("a", ("wind",)), ("a1", ("wind",)), ("b", ("wind", "aero_drag")), ("a2", ("wind",))):
        bus.publish(topics.MODEL_REVISION, revision(name, effects))
    journal.update(0, plan("a1", 1))
    rows = journal.revisions(0)
    assert [(row["revision"], row["adopted"]) for row in rows] == [("a", True), ("b", False), ("a2", False)]


def test_what_is_learnt_and_adopted_is_told_once_as_it_comes() -> None:
    bus = LocalBus()
    journal = Journal(bus)
    for kind in (EventKind.LEARNING, EventKind.FLAG, EventKind.ADOPTION, EventKind.ADOPTION):
        event = Event(stamp_ns=1, seq=1, kind=kind, severity=Severity.INFO, before="", after="b", text=f"about {kind}")
        bus.publish(topics.EVENT, event)
    journal.update(0, None)
    told = journal.news()
    assert [line.split()[0] for line in told] == ["learning", "adoption"]
    assert journal.news() == []


def test_a_flood_of_news_is_a_few_lines() -> None:
    bus = LocalBus()
    journal = Journal(bus)
    for seq in range(200):
        bus.publish(
            topics.EVENT,
            Event(
                stamp_ns=1, seq=seq, kind=EventKind.LEARNING, severity=Severity.INFO, before="", after="kept", text="?"
            ),
        )
    journal.update(0, None)
    assert len(journal.news()) == NEWS
    assert journal.news() == []
