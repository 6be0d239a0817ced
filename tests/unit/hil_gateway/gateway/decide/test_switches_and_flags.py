"""Switches at the car, service bits and yellow flags act as people mean them."""

from __future__ import annotations

import pytest
from support.cars.scripted_car import Rig
from support.promise_figures import volume

from benchmarks.faults.car_faults import CAR_FAULTS, listing
from hil_gateway.bus.messages import FailsafeAction, OperatorAction
from hil_gateway.bus.topics import RUN
from hil_gateway.bus.track_day.run import RunPhase, RunStatus
from hil_gateway.car.states import VehicleFlag
from hil_gateway.gateway.decide.failsafe import TABLE


@pytest.mark.parametrize(
    ("signal", "value", "cause"),
    [
        ("mode_switch_state", 0, "mode_switch_off"),
        ("safety_switch_state", 7, "safety_switch"),
        ("est1_oos_front_brk", 1, "car_failure"),
        ("est6_sd_ebrake", 1, "car_failure"),
    ],
)
def test_a_switch_or_service_bit_stops_the_car_and_refuses_arming(signal: str, value: int, cause: str) -> None:
    rig = Rig()
    rig.drive_off()
    rig.car.overrides[signal] = value
    rig.run(0.1)
    assert (rig.action, rig.cause) == (FailsafeAction.CONTROLLED_STOP, cause)
    rig = Rig()
    rig.run(1.0)
    rig.car.overrides[signal] = value
    rig.run(0.2)
    rig.ask(OperatorAction.ARM)
    rig.run(0.1)
    assert rig.action is FailsafeAction.SILENT
    assert cause in rig.status.missing_for_arming


@pytest.mark.parametrize(
    ("signal", "value", "cause", "after_s"),
    [("battery_voltage", 10.5, "supply_low", 1.0), ("engine_speed_rpm", 0.0, "engine_stalled", 0.3)],
)
def test_a_dying_supply_and_a_stalled_engine_stop_the_car(signal, value, cause, after_s):
    rig = Rig()
    rig.drive_off()
    rig.car.overrides[signal] = value
    rig.run(after_s - 0.1)
    assert rig.action is FailsafeAction.DRIVE
    rig.run(0.2)
    assert (rig.action, rig.cause) == (FailsafeAction.CONTROLLED_STOP, cause)


@pytest.mark.parametrize(
    ("phase", "box", "stops_after_s"),
    [
        (RunPhase.IN_LAP, 1, None),
        (RunPhase.DONE, 1, None),
        (RunPhase.FLYING, 1, 1.0),
        (RunPhase.OUT_LAP, 1, 1.0),
        (RunPhase.IN_LAP, None, 0.0),
        (RunPhase.NONE, None, 0.0),
        (None, None, 0.0),
    ],
)
def test_a_black_flag_stops_whatever_is_not_reported_to_come_in(
    phase: RunPhase | None, box: int | None, stops_after_s: float | None
) -> None:
    rig = Rig()
    if phase is not None:
        rig.hooks.append(lambda rig: rig.bus.publish(RUN, RunStatus(stamp_ns=0, seq=0, phase=phase, number=1, box=box)))
    rig.drive_off()
    assert stopped_after_s(rig, VehicleFlag.BLACK) == (
        None if stops_after_s is None else pytest.approx(stops_after_s, abs=0.02)
    )


@pytest.mark.parametrize(
    ("before", "now", "armed"),
    [
        ({"number": 0}, {"number": 0}, True),
        ({"number": 2}, {"number": 2}, True),
        ({"number": 2}, {"number": 0}, False),
        ({"number": 2}, {"number": 0, "phase": RunPhase.STARTING}, False),
        ({"number": 2}, {"number": 0, "answered": "run", "refused": "there is no box 7"}, False),
        ({"number": 2}, {"number": 0, "answered": "run"}, True),
        ({"number": 2}, {"number": 1, "answered": "run"}, True),
    ],
)
def test_a_new_planner_that_knows_nothing_of_the_run_is_not_armed(
    before: dict[str, object], now: dict[str, object], armed: bool
) -> None:
    """It would drive without the caps of the run; a person asks for the run again, or gives it up."""
    rig, says = Rig(), {"phase": RunPhase.FLYING, **before}
    rig.hooks.append(lambda rig: rig.bus.publish(RUN, RunStatus(stamp_ns=0, seq=0, **says)))
    rig.drive_off()
    rig.ask(OperatorAction.STOP)
    rig.run(3.0)
    says |= {"phase": RunPhase.NONE, **now}
    rig.run(0.1)
    rig.ask(OperatorAction.ARM)
    rig.run(0.1)
    assert (rig.action is FailsafeAction.DRIVE) is armed


def stopped_after_s(rig: Rig, flag: int, within_s: float = 3.0) -> float | None:
    """Seconds from when the gateway knows of a flag until it stops for it; None: it drives on."""
    rig.car.vehicle_flag = flag
    while rig.gateway.builder.vehicle_flag("vehicle_flag") != flag:
        rig.step()
    began_ns = rig.now_ns
    while rig.action is FailsafeAction.DRIVE:
        rig.step()
        if rig.now_ns - began_ns > within_s * 1e9:
            return None
    assert rig.cause == "vehicle_flag_stop"
    return (rig.now_ns - began_ns) / 1e9


@pytest.mark.parametrize("message", ["novatel_report", "wheel_speed_report", "imu_1"])
def test_a_second_sender_at_the_same_rate_stops_the_car_within_1_5_s(message: str) -> None:
    """Its frames say the same here: nothing but their number tells."""
    rig = Rig()
    rig.drive_off()

    def send_again(rig: Rig) -> None:
        if message != "novatel_report" or rig.car.tick % 5 == 0:
            rig.car.send(message, rig.car.signals())

    rig.hooks.append(send_again)
    rig.run(1.5)
    assert (rig.action, rig.cause) == (FailsafeAction.CONTROLLED_STOP, "sender_doubled")


def test_frames_that_waited_for_a_quarter_of_a_second_are_no_second_sender() -> None:
    rig = Rig()
    rig.drive_off()
    for _ in range(25):
        rig.car.send("pt_report_1", rig.car.signals())
    rig.run(1.0)
    assert rig.action is FailsafeAction.DRIVE


@pytest.mark.parametrize(
    ("named_mph", "reached"), [pytest.param((30.0,), 13.4, marks=pytest.mark.long), ((100.0, 0.0), 22.0)]
)
def test_a_full_course_yellow_slows_the_car_to_the_caution_speed(named_mph: tuple[float, ...], reached: float) -> None:
    rig = Rig()
    rig.drive = 0.1
    # wheels are never the same to the last bit, as those of a real car
    rig.hooks.append(lambda rig: rig.car.overrides.update(wheel_speed_FL=3.6 * rig.car.speed + 0.1 * (rig.tick % 7)))
    rig.drive_off(12.0)
    assert rig.car.speed > 25.0
    rig.car.track_flag = 9
    rig.car.overrides["round_target_speed"] = named_mph[0]
    rig.run(volume(12, 30))
    for named in named_mph:
        rig.car.overrides["round_target_speed"] = named
        rig.run(5.0)
        assert rig.action is FailsafeAction.DRIVE
        assert rig.car.ct_state == 8
        assert rig.car.speed == pytest.approx(reached, abs=1.5)
    rig.car.track_flag = 1
    rig.run(8.0)
    assert rig.car.speed > reached + 3.0


def test_what_notices_a_fault_is_a_row_of_the_failsafe_table() -> None:
    causes = {row.cause for row in TABLE}
    assert [fault.name for fault in CAR_FAULTS if not set(fault.noticed_by) <= causes] == []
    assert all(fault.name in listing() for fault in CAR_FAULTS)
