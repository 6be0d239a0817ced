"""A gateway that is asked to end stops the car first, where there is one to stop."""

from __future__ import annotations

import re

import pytest
from support.cars.scripted_car import Rig

from hil_gateway.bus.messages import FailsafeAction
from hil_gateway.config import Config
from hil_gateway.gateway.node import OrderlyEnd


def ending_of(rig: Rig, deceleration: float = 6.0) -> OrderlyEnd:
    return OrderlyEnd(rig.gateway, deceleration)


def seconds_until_over(rig: Rig, end: OrderlyEnd, most_s: float = 30.0) -> float:
    begin_ns = rig.now_ns
    while not end.over(rig.now_ns, 1):
        rig.step()
        assert rig.now_ns - begin_ns < most_s * 1e9
    return (rig.now_ns - begin_ns) / 1e9


@pytest.fixture
def driving() -> Rig:
    rig = Rig()
    rig.drive = 0.1
    rig.drive_off(6.0)
    assert rig.car.speed > 5.0
    return rig


def test_a_moving_car_is_stopped_by_the_table_and_the_process_goes_on_until_it_stands(driving: Rig) -> None:
    end, speed = ending_of(driving), driving.car.speed
    assert not end.over(driving.now_ns, 0)
    assert driving.action is FailsafeAction.DRIVE
    took_s = seconds_until_over(driving, end)
    assert (driving.action, driving.cause) == (FailsafeAction.CONTROLLED_STOP, "gateway_ending")
    assert driving.car.speed < 0.5
    assert speed / 12.0 < took_s < 2.0 * speed / 6.0, "braked neither by magic nor until the bound"
    assert driving.car.commands["F_brake_pressure_cmd"] > 0.0


def test_a_second_request_and_a_car_that_is_gone_wait_for_nothing(driving: Rig) -> None:
    end = ending_of(driving)
    assert not end.over(driving.now_ns, 1)
    assert end.over(driving.now_ns, 2)
    driving.car.reports = False
    assert seconds_until_over(driving, end) == pytest.approx(0.1, abs=0.02)
    assert driving.cause == "can_silent"


def test_a_car_that_does_not_slow_down_does_not_hold_up_the_end_for_ever(
    driving: Rig, caplog: pytest.LogCaptureFixture
) -> None:
    speed = driving.car.speed
    assert seconds_until_over(driving, ending_of(driving, 30.0)) == pytest.approx(2.0 * speed / 30.0, rel=0.05)
    assert re.search(r"the gateway ends at (9|1[01])\.", caplog.text)


@pytest.mark.parametrize("mode", ["armed", "shadow", "listen"])
def test_a_gateway_that_moves_no_car_ends_at_once(mode: str) -> None:
    rig = Rig(Config.model_validate({"gateway": {"mode": mode}}))
    assert ending_of(rig).over(rig.now_ns, 1), "before its first period"
    rig.run(1.0)
    assert ending_of(rig).over(rig.now_ns, 1)
    rig.car.speed = 20.0  # by a person, or rolling
    rig.run(0.05)
    assert ending_of(rig).over(rig.now_ns, 1)
