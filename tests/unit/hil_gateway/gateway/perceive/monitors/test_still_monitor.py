"""An IMU that hangs is found by what steering and wheels say of the next bend; a car that slides on is not one."""

from __future__ import annotations

import math
import random
from collections.abc import Callable

import pytest
from support.scripted_car import Rig

from hil_gateway.config import Config
from hil_gateway.gateway.perceive.monitors.still import StillMonitor

CONFIG, SPEED = Config(), 60.0
BEND = 0.25
"""rad/s"""
TURNS_IN = 50
"""periods"""
BRAKING = 6.0
"""m/s2"""

Rate = Callable[[int], float]


def bend(tick: int) -> float:
    """Yaw rate of a car that turns into a bend, rad/s."""
    return BEND * min(max(tick / TURNS_IN, 0.0), 1.0)


def straight(tick: int) -> float:
    return 0.0


def pressed(tick: int) -> float:
    """Deceleration of a car that brakes from tick 0 on, m/s2."""
    return BRAKING * min(max(tick / 10, 0.0), 1.0)


def found_s(
    gyro: Rate, front: Rate = bend, steered: Rate = bend, *, brakes: Rate = straight, wheels: Rate = straight,
    felt: Rate = straight,
) -> float:  # fmt: skip
    """Time from turning in until the IMU counts as standing still; every signal has noise. Decelerations: by the
    brakes as they are reported, of the wheels, and by the IMU, m/s2."""
    rig, noise = Rig(), random.Random(1)
    rig.run(0.05)
    state, monitor, speed = rig.gateway.seen[0], StillMonitor(CONFIG), SPEED
    per_drive = CONFIG.powertrain.force_per_drive / CONFIG.vehicle.mass
    for tick in range(-200, 300):
        half = 0.5 * CONFIG.vehicle.track_front * (front(tick) + noise.gauss(0, 0.02))
        speed -= 0.01 * wheels(tick)
        changes = {"wheel_speed_fl": speed - half, "wheel_speed_fr": speed + half, "steer": 0.0}
        changes |= {"wheel_speed_rl": speed + noise.gauss(0, 0.03), "wheel_speed_rr": speed + noise.gauss(0, 0.03)}
        changes |= {"yaw_rate": gyro(tick) + noise.gauss(0, 0.01), "drive": -brakes(tick) / per_drive}
        changes["ax"] = -felt(tick) + noise.gauss(0, 0.1)
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


def test_an_imu_that_moved_until_it_hung_is_found_before_that_is_forgotten() -> None:
    """The car straightens up after turning in, which the IMU has seen."""

    def swerve(tick: int) -> float:
        return bend(tick + 60) - 1.6 * bend(tick)

    assert 0.0 < found_s(lambda tick: swerve(min(tick, 0)), swerve, swerve) < 0.3


def test_brakes_and_wheels_that_slow_the_car_find_an_imu_that_does_not_feel_it() -> None:
    assert 0.0 < found_s(straight, straight, straight, brakes=pressed, wheels=pressed) < 0.3


@pytest.mark.parametrize(("brakes", "wheels"), [(pressed, straight), (straight, pressed)])
def test_brakes_that_are_dead_or_wheels_that_lie_have_no_wrong_imu(brakes: Rate, wheels: Rate) -> None:
    assert found_s(straight, straight, straight, brakes=brakes, wheels=wheels) == math.inf


def test_a_car_that_brakes_into_a_bend_finds_an_imu_that_feels_neither() -> None:
    """Its inner wheels slip, and say nothing of the turn."""
    assert 0.0 < found_s(straight, straight, bend, brakes=pressed) < 0.3


def test_a_car_that_slides_straight_on_as_it_brakes_has_no_wrong_imu() -> None:
    assert found_s(straight, straight, bend, brakes=pressed, wheels=pressed, felt=pressed) == math.inf


def test_a_car_that_leaves_its_brakes_in_a_steady_bend_has_no_wrong_imu() -> None:
    """It is steered more to keep the same bend, and its front wheels slip less unevenly."""

    def left(tick: int) -> float:
        return BRAKING - pressed(tick)

    def slip(tick: int) -> float:
        return 0.37 - 0.016 * left(tick)

    assert found_s(lambda tick: 0.37, slip, bend, brakes=left, wheels=left, felt=left) == math.inf


def test_a_car_that_drives_off_evenly_has_no_wrong_imu() -> None:
    """The IMU feels the same force before the car is fast enough to be judged and after."""
    rig, push, felt = Rig(), 8.2, 6.3
    rig.run(0.05)
    state, monitor, noise = rig.gateway.seen[0], StillMonitor(CONFIG), random.Random(1)
    drive = push * CONFIG.vehicle.mass / CONFIG.powertrain.force_per_drive
    held_s = []
    for tick in range(400):
        speed = 0.01 * felt * tick
        wheels = {f"wheel_speed_{w}": speed + noise.gauss(0, 0.03) for w in ("fl", "fr", "rl", "rr")}
        changes = {"steer": 0.0, "yaw_rate": noise.gauss(0, 0.002), "drive": drive, "ax": felt + noise.gauss(0, 0.02)}
        now = state.model_copy(update=wheels | changes)
        held_s.append(monitor.step(tick * 10_000_000, now, speed, 0.0, 0.0))
    assert max(held_s) == 0.0
