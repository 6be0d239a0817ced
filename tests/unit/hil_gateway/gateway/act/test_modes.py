"""What each mode sends, and what it never sends."""

from __future__ import annotations

import pytest
from support.cars.scripted_car import Rig

from benchmarks.promises.wire_judge import Judge
from can_dbc.codec import load_codec
from hil_gateway.bus.messages import FailsafeAction, OperatorAction
from hil_gateway.config import Config
from hil_gateway.gateway.act import actuator_test

DURATION_S = len(actuator_test.MOVES) * 4 * actuator_test.PHASE_S


def rig_in(mode: str) -> Rig:
    return Rig(Config.model_validate({"gateway": {"mode": mode}}))


@pytest.mark.parametrize("action", list(OperatorAction))
def test_listening_sends_no_frame_at_all(action):
    rig = rig_in("listen")
    rig.car.sys_state = 9
    rig.run(0.5)
    rig.ask(action)
    rig.run(0.5)
    rig.gateway.shut_down(rig.now_ns)
    rig.run(0.1)
    assert rig.car.heard == []
    assert rig.status.mode == "listen"


def test_shadow_plans_and_logs_and_sends_nothing():
    rig = rig_in("shadow")
    rig.car.sys_state, rig.drive = 9, 0.05
    rig.run(0.5)
    rig.ask(OperatorAction.ARM)
    rig.run(1.0)
    assert rig.action is FailsafeAction.DRIVE
    assert rig.car.heard == []
    assert not rig.applied[-1].sent
    assert rig.applied[-1].accelerator_percent > 0


def run_test(rig: Rig, seconds: float) -> list[dict[str, float]]:
    rig.planner_runs = rig.estimator_runs = False
    rig.car.overrides["engine_speed_rpm"] = 0.0
    rig.car.overrides["sys_state"] = 4
    rig.run(1.0)
    rig.ask(OperatorAction.ARM)
    rig.run(seconds)
    codec = load_codec()
    return [codec.decode_raw(frame.id, frame.data) for _, frame in rig.frames()]


def test_actuator_test_moves_one_actuator_at_a_time_and_little():
    rig = rig_in("actuator_test")
    frames = run_test(rig, DURATION_S + 1.0)
    names = ("steering_motor_ang_cmd", "F_brake_pressure_cmd", "R_brake_pressure_cmd", "acc_pedal_cmd")
    seen = {name: [frame[name] for frame in frames if name in frame] for name in names}
    extremes = {name: (min(values), max(values)) for name, values in seen.items()}
    assert extremes == {
        "steering_motor_ang_cmd": (-30.0, 30.0),
        "F_brake_pressure_cmd": (0.0, 500.0),
        "R_brake_pressure_cmd": (0.0, 500.0),
        "acc_pedal_cmd": (0.0, 5.0),
    }
    for i in range(0, len(frames) - 3, 4):
        period = {**frames[i], **frames[i + 1], **frames[i + 2], **frames[i + 3]}
        assert sum(period[name] != 0 for name in names) <= 1, period
        assert period["desired_gear"] == 0
    judge = Judge()
    for _, frame in rig.frames():
        judge.take(frame.id, frame.data)
    assert not judge.faults
    assert rig.car.ct_state == 3, "the ladder goes no further than the test"


@pytest.mark.parametrize(
    "spoil", [{"engine_speed_rpm": 800.0}, {"sys_state": 8}, {"sys_state": 9}, {"wheel_speed_RL": 9.0}]
)
def test_actuator_test_needs_the_engine_off_and_the_car_standing(spoil):
    rig = rig_in("actuator_test")
    rig.planner_runs = rig.estimator_runs = False
    rig.car.overrides |= {"engine_speed_rpm": 0.0, "sys_state": 4} | spoil
    rig.run(1.0)
    rig.ask(OperatorAction.ARM)
    rig.run(0.5)
    assert rig.action is FailsafeAction.SILENT
    assert rig.frames() == []


def test_an_engine_that_starts_ends_the_test():
    rig = rig_in("actuator_test")
    run_test(rig, 0.5)
    rig.car.overrides["engine_speed_rpm"] = 900.0
    rig.run(0.1)
    assert (rig.action, rig.cause) == (FailsafeAction.CONTROLLED_STOP, "engine_running")


@pytest.mark.parametrize("elapsed_s", [-1.0, 0.0, DURATION_S, 1e9])
def test_at_rest_outside_the_moves(elapsed_s):
    rest = actuator_test.position(elapsed_s, 4.0)
    assert (rest.steering_motor, rest.accelerator, rest.brake_front, rest.brake_rear) == (0, 0, 0, 0)


def test_the_first_move_is_to_the_left():
    assert actuator_test.position(1.5, 4.0).steering_motor == pytest.approx(0.5)


def test_a_car_that_moves_on_old_commands_is_stopped_by_a_gateway_that_sends_none():
    """What replaces a killed gateway is silent; the car is in driving again and still has its last accelerator."""
    rig = Rig(Config.model_validate({"gateway": {"hold": False}}))
    rig.car.commands["acc_pedal_cmd"], rig.car.supervised = 40.0, False
    rig.run(2.0)
    assert (rig.action, rig.car.ct_state, rig.car.sys_state) == (FailsafeAction.SILENT, 12, 16)
    assert rig.status.cause == "uncommanded_motion"
    assert rig.frames() == []
    rig.car.commands.clear()
    rig.car.speed = 0.0
    rig.run(0.5)
    rig.ask(OperatorAction.DISARM)
    rig.run(2.0)
    rig.ask(OperatorAction.ARM)
    rig.run(0.2)
    assert rig.action is FailsafeAction.DRIVE
    assert rig.status.cause == ""


@pytest.mark.parametrize("mode", ["shadow", "listen"])
def test_a_person_who_drives_is_nobody_s_emergency(mode):
    rig = rig_in(mode)
    rig.car.sys_state, rig.car.speed = 9, 30.0
    rig.run(1.0)
    assert rig.status.cause == ""
    assert rig.car.heard == []


def test_brakes_hold_from_when_the_steering_is_known_on_and_leave_it_where_it_is():
    rig = rig_in("armed")
    rig.car.sys_state = 9
    rig.car.overrides |= dict.fromkeys(
        ("primary_steering_angle_fbk", "secondary_steering_ang_fdbk", "average_steering_ang_fdbk"), 12.0
    )
    rig.car.muted = {"steering_report", "steering_report_extd", "steering_report_extd_2"}
    rig.run(0.5)
    assert rig.frames() == []
    rig.car.muted = set()
    rig.run(0.5)
    codec = load_codec()
    sent = [codec.decode_raw(frame.id, frame.data) for _, frame in rig.frames()]
    assert {values["F_brake_pressure_cmd"] > 0.0 for values in sent if "F_brake_pressure_cmd" in values} == {True}
    steering = [values["steering_motor_ang_cmd"] for values in sent if "steering_motor_ang_cmd" in values]
    assert len(steering) > 40 and steering == pytest.approx([12.0] * len(steering), abs=0.1)
