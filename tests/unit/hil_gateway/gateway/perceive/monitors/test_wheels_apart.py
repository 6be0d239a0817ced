"""Wheels that have been found out do not judge the IMU."""

from __future__ import annotations

import math

import pytest
from support.cars.scripted_car import Rig, reported_state
from support.cars.turning_car import TurningCar

from hil_gateway.car.actuation import ActuatorPositions
from hil_gateway.car.car import load_car
from hil_gateway.car.states import SysState
from hil_gateway.config import Config
from hil_gateway.gateway.perceive.course import Course
from hil_gateway.gateway.perceive.monitors.monitors import Monitors

CAR = load_car().vehicle
SPEED, SWAPPED = 50.0, 250
"""m/s; period in which the wheels of both sides are swapped"""


def test_wheels_that_all_others_contradict_judge_no_imu() -> None:
    """A car weaves, with everything else as it should be; what its wheels taught the observer fits no gyro later."""
    rig = Rig()
    rig.run(0.05)
    monitors, found = Monitors(Config(), None), False
    for tick in range(400):
        yaw_rate = 0.2 * math.sin(0.02 * tick)
        steer, side = math.atan(CAR.wheelbase * yaw_rate / SPEED), 0.5 * CAR.track_front * yaw_rate
        left, right = (SPEED - side, SPEED + side) if tick < SWAPPED else (SPEED + side, SPEED - side)
        changes = {"steer": steer, "yaw_rate": yaw_rate, "ay": SPEED * yaw_rate, "sys_state": SysState.DRIVING}
        changes |= {f"wheel_speed_{at}{of}": v for of, v in (("l", left), ("r", right)) for at in "fr"}
        state, now_ns = rig.gateway.seen[0].model_copy(update=changes), (tick + 1) * 10_000_000
        commanded = ActuatorPositions(CAR.steering_ratio * steer, 0.0, 0.0, 0.0, 3)
        monitors.motion.step(now_ns, state, None, commanded)
        found |= monitors.measures(now_ns, state, None, commanded, None)["wheel_speed_wrong"] > 0.1
    assert found
    assert not monitors.imu_wrong


@pytest.mark.parametrize("fixes", [True, False])
def test_an_imu_that_the_fixes_confirm_is_not_blamed_for_swapped_wheels(fixes: bool) -> None:
    """From a straight on, before a bend: all four wheels agree that it goes the other way."""
    monitors, car, before = Monitors(Config(), None), TurningCar(CAR, 60.0), reported_state()
    for tick in range(700):
        steer = car.angle(4e-3 * min(max(tick - SWAPPED, 0) / 300, 1.0))
        car.turn(steer)
        said = car.reports() | {"steer": steer, "sys_state": SysState.DRIVING}
        if tick >= SWAPPED:
            for axle in "fr":
                left, right = f"wheel_speed_{axle}l", f"wheel_speed_{axle}r"
                said[left], said[right] = said[right], said[left]
        state, now_ns = before.model_copy(update=said), (tick + 1) * 10_000_000
        course = Course(0.0, 0.0, 0.0, car.speed, car.yaw_rate, 0.03) if fixes else None
        monitors.motion.step(now_ns, state, course, None)
        monitors.measures(now_ns, state, None, None, course)
    assert monitors.imu_wrong is not fixes


def test_wheels_that_jump_by_less_than_fixes_tell_do_not_make_the_imu_wrong() -> None:
    """By 9 % at once, as where a second sender speaks: neither IMU nor brakes have slowed the car down."""
    rig = Rig()
    rig.run(0.05)
    monitors, course = Monitors(Config(), None), Course(0.0, 0.0, 0.0, SPEED, 0.0, 0.03)
    for tick in range(SWAPPED + 30):
        wheels = SPEED if tick < SWAPPED else 0.91 * SPEED
        changes = {f"wheel_speed_{at}": wheels for at in ("fl", "fr", "rl", "rr")}
        state = rig.gateway.seen[0].model_copy(update={**changes, "sys_state": SysState.DRIVING})
        commanded, now_ns = ActuatorPositions(0.0, 0.0, 0.0, 0.0, 3), (tick + 1) * 10_000_000
        monitors.motion.step(now_ns, state, course, commanded)
        measured = monitors.measures(now_ns, state, None, commanded, course)
    assert measured["acceleration_wrong"] > 0.1
    assert not monitors.imu_wrong
