"""Arming, latching and disarming by the whole gateway and a car on the wire."""

from __future__ import annotations

import time

import pytest
from support.cars.scripted_car import Rig
from support.promise_figures import record_figure

from hil_gateway.bus import topics
from hil_gateway.bus.messages import FailsafeAction, OperatorAction, OperatorCommand, PlanStatus
from hil_gateway.config import Config
from hil_gateway.gateway.check.arming import EXPLANATION
from hil_gateway.process.clock import SystemClock
from planner.process import announced


@pytest.mark.promise("S5")
def test_nothing_but_an_arm_request_ends_the_silence():
    for hold in (True, False):
        rig = Rig(Config.model_validate({"gateway": {"hold": hold}}))
        rig.run(3.0)
        assert rig.status.missing_for_arming == ()
        for action in (OperatorAction.DISARM, OperatorAction.STOP, OperatorAction.CRANK):
            rig.ask(action)
            rig.run(0.1)
        assert (rig.frames() != []) == hold
        assert rig.other_than_brakes() == []
    record_figure("S5", "all conditions met for 2 s: silent until a person arms, but for brakes where they are to hold")


@pytest.mark.promise("S5")
def test_a_request_to_arm_is_answered_at_once_or_forgotten():
    rig = Rig()
    rig.run(1.0)
    rig.estimate_valid = False
    rig.run(0.3)
    rig.ask(OperatorAction.ARM)
    rig.run(0.1)
    rig.estimate_valid = True
    rig.run(1.0)
    assert rig.status.missing_for_arming == ()
    assert rig.other_than_brakes() == [], "an old request must not arm later"
    assert not rig.status.armed
    rig.ask(OperatorAction.ARM)
    rig.step()
    assert rig.action is FailsafeAction.DRIVE


@pytest.mark.promise("S5")
def test_a_second_delivery_of_a_request_to_arm_does_not_arm_again():
    rig = Rig()
    rig.run(1.0)
    request = OperatorCommand(stamp_ns=7, seq=7, source="test", action=OperatorAction.ARM)
    rig.bus.publish(topics.OPERATOR, request)
    rig.run(0.5)
    assert rig.action is FailsafeAction.DRIVE
    rig.ask(OperatorAction.STOP)
    rig.run(3.0)
    assert rig.car.speed == 0
    rig.bus.publish(topics.OPERATOR, request)
    rig.run(0.2)
    assert rig.action is FailsafeAction.CONTROLLED_STOP


@pytest.mark.parametrize("spoil", ["can", "state", "estimate", "plan", "sys_state", "heartbeat", "moving", "mode"])
@pytest.mark.promise("S5")
def test_the_whole_gateway_refuses_to_arm_with_one_thing_missing(spoil):
    mode = "listen" if spoil == "mode" else "armed"
    rig = Rig(Config.model_validate({"gateway": {"mode": mode}}))
    rig.run(1.0)
    if spoil == "can":
        rig.car.reports = False
    elif spoil == "state":
        rig.car.muted.add("imu_1")
    elif spoil == "estimate":
        rig.estimate_valid = False
    elif spoil == "plan":
        rig.planner_runs = False
    elif spoil == "sys_state":
        rig.car.overrides["sys_state"] = 8
    elif spoil == "heartbeat":
        rig.car.heartbeat_runs = False
    elif spoil == "moving":
        rig.car.overrides["wheel_speed_FL"] = 3.0 * 3.6
    rig.run(0.7)
    rig.ask(OperatorAction.ARM)
    rig.run(0.2)
    assert rig.action is FailsafeAction.SILENT
    assert rig.other_than_brakes() == []
    assert rig.status.missing_for_arming
    record_figure("S5", f"gateway refuses with {spoil} missing")


@pytest.mark.promise("S5")
def test_a_failsafe_latches_until_a_person_arms_again():
    rig = Rig()
    rig.drive_off()
    rig.car.track_flag = 3
    rig.run(0.5)
    assert (rig.action, rig.cause) == (FailsafeAction.CONTROLLED_STOP, "track_flag_stop")
    rig.car.track_flag = 1
    rig.run(3.0)
    assert rig.car.speed == 0
    assert rig.action is FailsafeAction.CONTROLLED_STOP, "the cause is gone, the stop stays"
    rig.ask(OperatorAction.ARM)
    rig.run(0.5)
    assert rig.action is FailsafeAction.DRIVE
    assert rig.car.ct_state == 9


@pytest.mark.promise("S5")
def test_after_an_emergency_arming_alone_is_not_enough():
    rig = Rig()
    rig.drive_off()
    rig.ask(OperatorAction.EMERGENCY)
    rig.run(4.0)
    assert rig.car.speed == 0
    assert rig.car.ct_state == 12
    rig.ask(OperatorAction.ARM)
    rig.run(0.5)
    assert rig.action is FailsafeAction.EMERGENCY_STOP
    rig.ask(OperatorAction.DISARM)
    rig.run(2.0)
    assert rig.action is FailsafeAction.SILENT
    rig.ask(OperatorAction.ARM)
    rig.run(0.1)
    assert rig.action is FailsafeAction.DRIVE


@pytest.mark.parametrize("stop", [OperatorAction.STOP, OperatorAction.EMERGENCY])
def test_after_disarming_the_ladder_is_climbed_again_with_the_car(stop):
    """Without commands the car goes into its own emergency: neither side may wait for the other for ever."""
    rig = Rig()
    rig.drive_off()
    rig.ask(stop)
    rig.run(4.0)
    rig.ask(OperatorAction.DISARM)
    rig.run(3.0)
    assert rig.status.missing_for_arming == ()
    rig.ask(OperatorAction.ARM)
    rig.run(0.5)
    assert rig.action is FailsafeAction.DRIVE


def test_disarming_a_silent_gateway_changes_nothing():
    rig = Rig()
    rig.run(1.0)
    rig.ask(OperatorAction.DISARM)
    rig.run(0.5)
    assert rig.car.ct_state == 9
    assert rig.status.missing_for_arming == ()


def test_disarming_while_moving_stops_the_car_first():
    rig = Rig()
    rig.drive_off(3.0)
    rig.ask(OperatorAction.DISARM)
    rig.step()
    assert (rig.action, rig.cause) == (FailsafeAction.CONTROLLED_STOP, "disarmed_moving")
    rig.run(4.0)
    assert rig.car.speed == 0
    rig.ask(OperatorAction.DISARM)
    rig.step()
    assert rig.action is FailsafeAction.SILENT


def test_a_planner_that_publishes_no_plans_is_armed_by_a_command_that_drives():
    rig = Rig()
    rig.publishes_plans, rig.drive = False, 0.0
    rig.run(1.5)
    assert rig.status.missing_for_arming == ("plan_standing",)
    rig.drive = 0.02
    rig.run(0.3)
    rig.ask(OperatorAction.ARM)
    rig.run(0.2)
    assert rig.action is FailsafeAction.DRIVE


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"status": PlanStatus.NOT_MOVING, "reason": "92 degrees across the track: turn it"}, "92 degrees"),
        ({"status": PlanStatus.STOP, "reason": "solver: iteration limit"}, "iteration limit"),
        ({"status": PlanStatus.SHIFTED, "reason": "solver: late"}, "late"),
        ({"vx": (0.0,) * 41}, "does not drive off"),
        ({"vx": (0.0,) * 20 + (5.0,) * 21}, "does not drive off"),
    ],
)
@pytest.mark.promise("S5")
def test_a_plan_that_does_not_drive_off_refuses_arming_and_says_why(changes: dict[str, object], said: str) -> None:
    rig = Rig()
    rig.plan_changes = changes
    rig.run(1.5)
    assert rig.status.missing_for_arming == ("plan_standing",)
    assert said in rig.status.advice["plan_standing"]
    rig.ask(OperatorAction.ARM)
    rig.run(0.2)
    assert rig.action is FailsafeAction.SILENT
    rig.plan_changes = {}
    rig.run(0.2)
    rig.ask(OperatorAction.ARM)
    rig.run(0.1)
    assert rig.action is FailsafeAction.DRIVE


@pytest.mark.promise("S5")
def test_an_estimate_that_is_not_where_the_fixes_are_refuses_arming() -> None:
    rig = Rig()
    rig.aside = 2.0
    rig.run(1.5)
    assert rig.status.missing_for_arming == ("estimate_unfit",)
    assert "2.0 m" in rig.status.advice["estimate_unfit"]


@pytest.mark.promise("S5")
def test_without_a_heading_arming_asks_for_a_push_where_it_must_be_known() -> None:
    rig = Rig(Config.model_validate({"gateway": {"arming": {"heading": "known"}}}))
    rig.lacks = "heading"
    rig.run(1.5)
    assert rig.status.missing_for_arming == ("heading_unknown",)


@pytest.mark.promise("S5")
def test_the_first_metres_may_show_the_heading_and_end_where_they_have_not() -> None:
    rig = Rig()
    rig.lacks = "heading"
    rig.plan_changes = {"status": PlanStatus.FIRST_METRES, "vx": (1.5,) * 41}
    rig.run(1.5)
    rig.ask(OperatorAction.ARM)
    rig.run(0.1)
    assert rig.action is FailsafeAction.DRIVE
    begun = rig.car.x
    while rig.action is FailsafeAction.DRIVE and rig.car.x < begun + 30.0:
        rig.step()
    assert rig.cause == "heading_unknown"
    assert 5.5 < rig.car.x - begun < 7.0
    rig = Rig()
    rig.drive_off()
    assert rig.action is FailsafeAction.DRIVE


def test_who_is_silent_first_is_named_first_and_an_estimate_that_is_gone_asks_for_no_push() -> None:
    rig = Rig()
    rig.drive_off()
    rig.estimator_runs = rig.planner_runs = False
    rig.run(3.0)
    assert rig.cause == "command_dead" and rig.car.speed == 0
    rig.aside = 2.0
    rig.run(0.2)
    assert rig.status.missing_for_arming == ("estimate_invalid", "command_dead", "command_stale")


def test_a_process_that_speaks_is_not_to_be_started() -> None:
    """A planner without an estimate plans and does not command: what is missing is what its plans name."""
    rig = Rig()
    rig.estimate_valid = rig.planner_runs = False
    rig.plan_changes = {"status": PlanStatus.SHIFTED, "reason": "no valid estimate"}
    rig.hooks.append(lambda rig: rig.bus.publish(topics.PLAN, rig.plan(rig.now_ns)))
    rig.run(1.5)
    assert {"estimate_invalid", "command_dead"} <= set(rig.status.missing_for_arming)
    assert rig.status.advice["estimate_invalid"] == "no valid estimate"
    assert rig.status.advice["command_dead"] == "no planner sends commands: no valid estimate"
    rig.estimator_runs = False
    rig.hooks.clear()
    rig.run(1.0)
    assert not {"estimate_invalid", "command_dead"} & set(rig.status.advice)
    assert EXPLANATION["command_dead"] == "no planner sends commands: `hil planner run`"


def test_a_planner_that_compiles_is_not_called_missing() -> None:
    """From its announcement until it plans, and not beyond its end."""
    rig = Rig()
    rig.planner_runs = False
    rig.run(1.5)
    missing = rig.status.missing_for_arming
    assert "command_dead" in missing
    assert "command_dead" not in rig.status.advice
    announcements = rig.bus.subscribe(topics.RUN, depth=10)
    with announced(rig.bus, SystemClock()):
        time.sleep(3.0 / topics.RUN.rate_hz)
    assert len(announcements.poll(0)) >= 2
    rig.run(0.2)
    assert rig.status.missing_for_arming == missing
    assert {"command_dead", "plan_standing"} <= {k for k, v in rig.status.advice.items() if "compiles" in v}
    rig.run(1.5 * topics.RUN.deadline_s)
    assert not any("compiles" in text for text in rig.status.advice.values())
