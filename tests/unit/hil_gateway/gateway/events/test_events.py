"""The event log: every change of the loop is one typed entry, with its cause, what was measured and the limit."""

from __future__ import annotations

import pytest
from support.cars.scripted_car import Rig

from can_dbc.codec import load_codec
from hil_gateway.bus import messages as m
from hil_gateway.bus import topics
from hil_gateway.bus.event import Event, EventKind, Severity
from hil_gateway.bus.messages import FailsafeAction, OperatorAction
from hil_gateway.bus.proposal import ModelProposal
from hil_gateway.gateway.decide.failsafe import HOLDS, MEASURES, TABLE, Failsafe, Inputs
from hil_gateway.gateway.events.change import Seen, changes
from hil_gateway.gateway.events.log import MOST_A_MINUTE, MOST_A_SECOND, EventLog, journal_line
from hil_gateway.process.clock import NS_PER_S


class LoggedRig(Rig):
    """A rig with the event log beside its gateway, as the gateway process has it."""

    def __init__(self) -> None:
        super().__init__()
        self.events: list[Event] = []
        self.log = log = EventLog(self.bus, self.events.append)
        self.published = self.bus.subscribe(topics.EVENT, depth=1000)
        self.hooks.append(lambda rig: log.step(rig.now_ns, rig.gateway) if rig.gateway_runs else None)

    def of(self, *kinds: EventKind) -> list[Event]:
        return [event for event in self.events if event.kind in kinds]


def test_a_stop_is_logged_with_its_first_and_its_last_cause_what_was_measured_and_the_limit():
    rig = LoggedRig()
    rig.drive_off()
    rig.planner_runs = False
    rig.run(1.5)
    armed, first, last = rig.of(EventKind.ARMING, EventKind.FAILSAFE)
    assert (armed.before, armed.after) == ("silent", "drive")
    assert (first.before, first.after, first.cause) == ("drive", "controlled_stop", "command_stale")
    assert (last.before, last.after, last.cause) == ("controlled_stop", "emergency_stop", "command_dead")
    for event, limit in ((first, 0.1), (last, 0.5)):
        assert event.limit == limit and event.unit == "s" and event.severity is Severity.STOP
        assert event.measured is not None and limit <= event.measured < limit + 0.02
    assert "planner late" in first.text


def test_an_emergency_while_silent_is_logged_as_a_stop_with_its_cause():
    rig = LoggedRig()
    rig.run(1.0)
    rig.ask(OperatorAction.EMERGENCY)
    rig.run(0.5)
    (stop,) = rig.of(EventKind.FAILSAFE)
    assert (stop.before, stop.after, stop.cause) == ("silent", "emergency", "operator_emergency")
    assert stop.severity is Severity.STOP


def test_an_e_kill_that_the_car_obeys_first_is_logged_as_such():
    rig = LoggedRig()
    rig.drive_off()
    rig.car.overrides["sys_state"] = 16
    rig.run(0.05)
    rig.car.marelli_vehicle_flag = 33
    rig.run(0.5)
    first, then = rig.of(EventKind.FAILSAFE)
    assert (first.cause, then.cause) == ("car_emergency", "vehicle_flag_kill")
    assert rig.status.cause == "vehicle_flag_kill"


def test_what_is_published_is_what_is_written_down_in_order():
    rig = LoggedRig()
    rig.drive_off()
    rig.ask(OperatorAction.STOP)
    rig.run(0.2)
    published = rig.published.poll(rig.now_ns)
    assert published == rig.events
    assert [event.seq for event in published] == list(range(len(published)))


@pytest.mark.parametrize("row", TABLE, ids=lambda row: row.cause)
def test_every_row_of_the_failsafe_table_says_in_words_why(row):
    measures = dict.fromkeys(MEASURES, 0.0) | {row.measure: row.threshold_s or HOLDS}
    driving = Seen(Failsafe(FailsafeAction.DRIVE))
    stopped = Seen(Failsafe(row.action, row.cause), inputs=Inputs(measures, standing=False))
    (change,) = changes(driving, stopped)
    assert change.text != row.cause and len(change.text.split()) >= 3
    assert (change.measured is None) == (row.threshold_s == 0.0)
    assert change.limit == (row.threshold_s or None)


def test_the_ladder_the_car_and_the_flags_are_named_not_numbered():
    rig = LoggedRig()
    rig.drive_off()
    ladder = [event.after for event in rig.of(EventKind.LADDER)]
    assert ladder[-1] == "nominal_race" and "race_ready" in ladder
    rig.car.track_flag = 3
    rig.run(0.1)
    assert [event.after for event in rig.of(EventKind.FLAG)][-1] == "red"
    assert rig.of(EventKind.FLAG)[-1].severity is Severity.STOP


def test_a_refused_arming_says_what_is_missing():
    rig = LoggedRig()
    rig.planner_runs = False
    rig.run(1.0)
    rig.ask(OperatorAction.ARM)
    rig.run(0.1)
    (refused,) = rig.of(EventKind.ARMING)
    assert refused.before == refused.after == "silent"
    assert "command_dead" in refused.cause and "refused" in refused.text


def test_a_process_that_falls_silent_is_said_once_and_so_is_its_return():
    rig = LoggedRig()
    rig.run(1.0)
    rig.planner_runs = False
    rig.run(2.0)
    rig.planner_runs = True
    rig.run(0.5)
    seen = [event.after for event in rig.of(EventKind.PROCESS)]
    assert seen == ["planner speaks", "planner silent", "planner speaks"]


def test_alerts_revisions_and_adoptions_are_entries_too():
    rig = LoggedRig()
    rig.run(0.1)
    rig.bus.publish(
        topics.ALERT,
        m.Alert(stamp_ns=1, seq=0, channel="ax", condition="driving", suspected_effect="aero_drag", strength=4),
    )
    effect = m.ActiveEffect(name="aero_drag", parameters={"c": 1.2})
    rig.bus.publish(
        topics.MODEL_REVISION,
        m.ModelRevision(stamp_ns=1, seq=0, revision="r1", layout="shared", tyre={"cx": 5e4}, effects=(effect,)),
    )
    rig.run(0.1)
    (alert,), (revision,), (adopted,) = (
        rig.of(kind) for kind in (EventKind.ALERT, EventKind.REVISION, EventKind.ADOPTION)
    )
    assert alert.cause == "aero_drag" and alert.measured == 4
    assert revision.after == "r1" and "aero_drag" in revision.text
    assert adopted.after == rig.plan(0).revision


@pytest.mark.parametrize(("outcome", "severity"), [("kept", Severity.INFO), ("withdrawn", Severity.WARNING)])
def test_what_the_learner_makes_of_the_laps_is_an_entry_with_its_reason(outcome, severity):
    rig = LoggedRig()
    rig.run(0.1)
    told = ModelProposal(stamp_ns=1, seq=0, outcome=outcome, lap=3, effects=("aero_drag",), reason="vy is worse")
    rig.bus.publish(topics.MODEL_PROPOSAL, told)
    rig.run(0.1)
    (event,) = rig.of(EventKind.LEARNING)
    assert (event.after, event.severity) == (outcome, severity)
    assert event.text == "after lap 3: aero_drag: vy is worse"


def test_a_flood_of_one_kind_is_bounded_what_is_left_out_is_counted_and_a_stop_still_gets_through():
    rig = LoggedRig()
    rig.drive_off()
    alert = m.Alert(stamp_ns=1, seq=0, channel="ax", condition="driving", strength=4)
    rig.hooks.append(lambda rig: rig.bus.publish(topics.ALERT, alert))
    rig.run(2.0)
    rig.ask(OperatorAction.STOP)
    rig.run(0.1)
    alerts = rig.of(EventKind.ALERT)
    assert MOST_A_SECOND <= len(alerts) <= 3 * MOST_A_SECOND
    assert any("more in between not listed" in event.text for event in alerts)
    assert rig.of(EventKind.FAILSAFE)[-1].cause == "operator_stop"


def test_a_flood_that_goes_on_is_one_line_a_second_at_most():
    rig = LoggedRig()
    rig.run(0.1)
    told = ModelProposal(stamp_ns=1, seq=0, outcome="kept", lap=3, reason="nothing better")

    def flood(seconds: float) -> None:
        for _ in range(round(100 * seconds)):
            rig.bus.publish(topics.MODEL_PROPOSAL, told)
            rig.clock.advance(NS_PER_S // 100)
            rig.log.step(rig.now_ns, rig.gateway)

    flood(50.0)
    assert len(rig.of(EventKind.LEARNING)) == MOST_A_MINUTE
    flood(20.0)
    assert any("more in between not listed" in event.text for event in rig.of(EventKind.LEARNING))


def test_a_line_of_the_log_has_everything_a_reader_of_the_journal_needs(monkeypatch):
    event = Event(
        stamp_ns=5 * NS_PER_S, seq=0, kind=EventKind.FAILSAFE, severity=Severity.STOP, before="drive",
        after="controlled_stop", cause="command_stale", measured=0.11, limit=0.1, unit="s", text="no fresh command",
    )  # fmt: skip
    monkeypatch.setenv("JOURNAL_STREAM", "8:1")
    assert journal_line(event) == (
        "<2>event: failsafe drive -> controlled_stop [command_stale]: no fresh command, 0.11 s (limit 0.1 s)"
    )


def test_a_text_of_another_process_makes_no_line_of_its_own():
    rig = LoggedRig()
    rig.run(0.1)
    forged = "nothing\n<2>event: failsafe drive -> emergency_stop\x1b[2J"
    rig.bus.publish(topics.MODEL_PROPOSAL, ModelProposal(stamp_ns=1, seq=0, outcome="kept", lap=3, reason=forged))
    rig.run(0.1)
    (event,) = rig.of(EventKind.LEARNING)
    assert journal_line(event).isprintable()


def test_a_second_gateway_on_the_bus_is_said_once():
    rig = LoggedRig()
    rig.run(0.1)
    layout, second = load_codec().messages["ct_report"], rig.wire.link()
    for _ in range(5):
        second.send(layout.id, bytes(layout.dlc))
        rig.run(0.5)
    (event,) = rig.of(EventKind.BUS)
    assert event.after == "second computer"
    assert event.severity is Severity.WARNING
