"""The IMU's gain against how steering and front wheels both say the car turns."""

from __future__ import annotations

import math
import random
from collections.abc import Callable

import pytest

from hil_gateway.gateway.perceive.monitors.gain import JUDGED_FROM, GainMonitor

SPEED = 70.0
BEND = 0.3
"""rad/s"""


def turning_in(t: float) -> float:
    """A straight, and from 0.5 s on a bend that begins as fast roads turn, rad/s."""
    return min(max(t - 0.5, 0.0) * 0.2, BEND)


def noticed(
    turn: Callable[[float], float], *, gyro: float = 1.0, force: float = 1.0, steering: float = 1.0,
    wheels: float = 1.0, speed: float = SPEED,
) -> tuple[float, float]:  # fmt: skip
    """Time after which it is found, s (infinite if not), and the angle the car has turned by until then, rad; each
    source with its gain, and with the noise of a real one."""
    rng, monitor, angle = random.Random(1), GainMonitor(), 0.0
    for period in range(2000):
        t = 0.01 * period
        r = turn(t)
        imu = gyro * r + rng.gauss(0, 1.5e-3), speed * (force * r) + rng.gauss(0, 0.1)
        if period == 0:
            monitor.step(speed, imu, None)  # its filters begin with the sound gyro
        monitor.step(speed, imu, (steering * r, wheels * r + rng.gauss(0, 0.003 * speed / 1.6)))
        angle += 0.01 * r
        if monitor.found:
            return t, angle
    return math.inf, angle


def test_a_sound_imu_is_believed_on_a_straight_and_in_a_bend():
    assert math.isinf(noticed(turning_in)[0])
    assert math.isinf(noticed(lambda t: BEND * math.sin(2.0 * t))[0])


@pytest.mark.parametrize("gain", [-1.0, 0.0])
def test_a_gyro_of_another_gain_is_found_in_a_bend_within_two_periods(gain):
    assert noticed(lambda t: BEND, gyro=gain)[0] <= 0.05  # the filter of the wheels


@pytest.mark.parametrize(("gyro", "force"), [(-1.0, 1.0), (-1.0, -1.0), (0.0, 0.0), (1.0, -1.0)])
def test_one_that_went_wrong_on_a_straight_is_found_before_the_heading_is_wrong_by_a_twentieth(gyro, force):
    after_s, angle = noticed(turning_in, gyro=gyro, force=force)
    assert after_s < 1.2
    assert angle * (1.0 - gyro) < 0.05


def test_steering_and_wheels_that_contradict_each_other_blame_nothing():
    """A slide that is caught: the wheels say how the car turns, the steering the other side; and swapped wheels."""
    assert math.isinf(noticed(lambda t: BEND, steering=-1.0)[0])
    assert math.isinf(noticed(lambda t: BEND, wheels=-1.0)[0])


@pytest.mark.parametrize("wrong", ["steering", "wheels"])
def test_understeer_that_one_of_them_does_not_know_blames_nothing(wrong):
    assert math.isinf(noticed(lambda t: BEND, **{wrong: 3.0})[0])


def test_a_slow_car_is_not_judged():
    assert math.isinf(noticed(lambda t: BEND, gyro=-1.0, speed=JUDGED_FROM - 1.0)[0])


def test_it_holds_until_the_car_stands():
    monitor = GainMonitor()
    for _ in range(20):
        monitor.step(SPEED, (-BEND, SPEED * BEND), (BEND, BEND))
    monitor.step(SPEED, (BEND, SPEED * BEND), None)
    assert monitor.found
    monitor.step(0.0, (0.0, 0.0), None)
    assert not monitor.found


@pytest.mark.parametrize(
    ("gyro", "force", "sign", "across"), [(-1.0, -1.0, -1.0, -1.0), (-1.0, 1.0, -1.0, 1.0), (1.0, -1.0, 1.0, -1.0)]
)
def test_a_wrong_sign_is_taken_back(gyro, force, sign, across):
    monitor = GainMonitor()
    for _ in range(100):
        monitor.step(SPEED, (gyro * 0.1, SPEED * force * 0.1), (0.1, 0.1))
    assert monitor.repair is not None
    assert (monitor.repair.sign, monitor.repair.force) == (sign, across)


def test_a_gyro_that_shows_nothing_cannot_be_repaired():
    monitor = GainMonitor()
    for _ in range(100):
        monitor.step(SPEED, (0.0, SPEED * 0.1), (0.1, 0.1))
    assert monitor.found and monitor.repair is None
