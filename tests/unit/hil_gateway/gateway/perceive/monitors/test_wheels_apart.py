"""Wheels that have been found out do not judge the IMU."""

from __future__ import annotations

import math

from support.cars.scripted_car import Rig

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


def test_wheels_that_jump_by_less_than_fixes_tell_do_not_make_the_imu_wrong() -> None:
    """By 9 % at once, as where a second sender speaks: neither IMU nor brakes have slowed the car down."""
    rig = Rig()
    rig.run(0.05)
    monitors, course = Monitors(Config(), None), Course(0.0, 0.0, 0.0, SPEED, 0.0)
    for tick in range(SWAPPED + 30):
        wheels = SPEED if tick < SWAPPED else 0.91 * SPEED
        changes = {f"wheel_speed_{at}": wheels for at in ("fl", "fr", "rl", "rr")}
        state = rig.gateway.seen[0].model_copy(update={**changes, "sys_state": SysState.DRIVING})
        commanded, now_ns = ActuatorPositions(0.0, 0.0, 0.0, 0.0, 3), (tick + 1) * 10_000_000
        monitors.motion.step(now_ns, state, course, commanded)
        measured = monitors.measures(now_ns, state, None, commanded, course)
    assert measured["acceleration_wrong"] > 0.1
    assert not monitors.imu_wrong
