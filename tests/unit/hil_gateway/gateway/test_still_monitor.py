"""An IMU that hangs is found by what steering and wheels say of the next bend; a car that slides on is not one."""

from __future__ import annotations

import math
import random
from collections.abc import Callable

import pytest
from support.scripted_car import Rig

from hil_gateway.config import Config
from hil_gateway.gateway.perceive.monitors.sensors import StillMonitor

CONFIG, SPEED = Config(), 60.0
BEND = 0.25
"""rad/s"""
TURNS_IN = 50
"""periods"""

Rate = Callable[[int], float]


def bend(tick: int) -> float:
    """Yaw rate of a car that turns into a bend, rad/s."""
    return BEND * min(max(tick / TURNS_IN, 0.0), 1.0)


def straight(tick: int) -> float:
    return 0.0


def found_s(gyro: Rate, front: Rate = bend, steered: Rate = bend) -> float:
    """Time from turning in until the IMU counts as standing still; every signal has noise."""
    rig, noise = Rig(), random.Random(1)
    rig.run(0.05)
    state, monitor = rig.gateway.seen[0], StillMonitor(CONFIG)
    for tick in range(-200, 300):
        half = 0.5 * CONFIG.vehicle.track_front * (front(tick) + noise.gauss(0, 0.02))
        changes = {"wheel_speed_fl": SPEED - half, "wheel_speed_fr": SPEED + half, "steer": 0.0}
        changes["yaw_rate"] = gyro(tick) + noise.gauss(0, 0.01)
        ay = SPEED * gyro(tick) + noise.gauss(0, 0.1)
        now_ns = (tick + 201) * 10_000_000
        if monitor.step(now_ns, state.model_copy(update=changes), SPEED, steered(tick), ay) > 0.1:
            return 0.01 * tick
    return math.inf


@pytest.mark.parametrize("value", [0.0, 0.1, -0.2])
def test_an_imu_that_hangs_is_found_while_the_car_turns_into_the_next_bend(value: float) -> None:
    assert 0.0 < found_s(lambda tick: value) <= 0.01 * TURNS_IN


def test_an_imu_that_follows_late_and_weakly_does_not_hang() -> None:
    assert found_s(lambda tick: 0.6 * bend(tick - 10)) == math.inf


@pytest.mark.parametrize(("front", "steered"), [(straight, bend), (bend, straight)])
def test_a_car_that_does_not_follow_its_steering_or_whose_wheels_slip_has_no_wrong_imu(
    front: Rate, steered: Rate
) -> None:
    assert found_s(straight, front, steered) == math.inf


@pytest.mark.parametrize("held", [0.36, 0.15, -0.15])
def test_a_car_that_is_steered_more_than_its_tyres_hold_has_no_wrong_imu(held: float) -> None:
    """On a dry and on a wet road, rad/s."""

    def more(tick: int) -> float:
        return held + math.copysign(bend(tick), held)

    assert found_s(lambda tick: held, more, more) == math.inf


def test_an_imu_that_hangs_in_a_bend_is_found_when_the_bend_ends() -> None:
    def ends(tick: int) -> float:
        return 0.3 - 1.2 * bend(tick)

    assert 0.0 < found_s(lambda tick: 0.3, ends, ends) <= 0.01 * TURNS_IN
