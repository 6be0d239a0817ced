"""Steering that goes to the other side, or stands still, and brakes that are weak are told from late ones, and from
sensors that are wrong."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
from support.cars.scripted_car import Rig
from support.cars.turning_car import ObservedCar, TurningCar

from hil_gateway.car.actuation import ActuatorPositions
from hil_gateway.car.car import load_car
from hil_gateway.car.states import SysState
from hil_gateway.config import Config
from hil_gateway.gateway.perceive.course import Course
from hil_gateway.gateway.perceive.monitors.actuators import FollowingMonitor, SteeringMonitor
from hil_gateway.gateway.perceive.monitors.monitors import Monitors
from hil_gateway.observer.steering import SteeringHypotheses

SPEED = 40.0
CAR = load_car().vehicle
TURNS = SteeringHypotheses(load_car())
"""that have been told nothing"""
LATE = 8
"""periods from a command to its position"""
LATE_SLOW_RAD = 0.008
"""a period at the motor: steering that has become slow"""

Motor = Callable[[int], float]


def chicane(tick: int) -> float:
    """Commanded angle of the motor, rad: a bend to the left, then one to the right."""
    return 0.35 if tick < 100 else max(0.35 - 0.03 * (tick - 100), -0.35)


def reversed_steering(tick: int) -> float:
    since = max(tick - LATE, 0)
    return chicane(since) if tick < 60 else max(0.35 - 0.05 * (tick - 60), -0.35) if tick < 75 else -chicane(since)


def late(tick: int) -> float:
    return chicane(max(tick - LATE, 0))


def slow(tick: int) -> float:
    return 0.35 if tick < 100 else max(0.35 - LATE_SLOW_RAD * (tick - 100), -0.35)


def stuck(tick: int) -> float:
    return 0.35


def turning_in(tick: int) -> float:
    """Commanded angle of a long bend that begins slowly, 11 deg/s at the motor, rad."""
    return 0.002 * tick


def gently_reversed(tick: int) -> float:
    return -turning_in(max(tick - LATE, 0))


def hairpin(tick: int) -> float:
    """More than any tyres follow."""
    return min(max(0.04 * tick, 0.0), 4.0)


def found_after(reported: Motor, turned: Motor, asked: Motor = chicane, zero: float = 0.0) -> float:
    """Periods until it is found. `reported` and true angle of the motor; the car turns at most as the declared
    tyres hold."""
    car = ObservedCar(SPEED, CAR.pressed(SPEED) * load_car().tyres.grip)
    monitor, ratio = SteeringMonitor(load_car()), CAR.steering_ratio
    for tick in range(-400, 0):  # what the car is like is learnt
        turned_to = (turned(0) + 0.3 * weave(tick)) / ratio
        car.step((asked(0) + 0.3 * weave(tick + LATE)) / ratio, turned_to, turned_to)
    for tick in range(200):
        steer = reported(tick) / ratio
        turns = car.step(asked(tick) / ratio, steer + zero, turned(tick) / ratio)
        state = car.state.model_copy(update={"steer": steer})
        monitor.step(state, turns, SPEED, ActuatorPositions(asked(tick), 0.0, 0.0, 0.0, 3), zero, keeps=True)
        if monitor.found:
            return tick
    return math.inf


def finds(reported: Motor, turned: Motor, asked: Motor = chicane) -> bool:
    return found_after(reported, turned, asked) < math.inf


def test_reversed_steering_is_told() -> None:
    assert finds(reversed_steering, reversed_steering)


def test_reversed_steering_is_told_where_its_command_moves_slowly() -> None:
    assert finds(gently_reversed, gently_reversed, turning_in)
    assert not finds(lambda tick: -0.1, lambda tick: -0.1, turning_in), "it stands to the other side"


def test_reversed_steering_is_told_beyond_what_the_tyres_follow() -> None:
    def reverse(tick: int) -> float:
        return -hairpin(tick - LATE)

    assert finds(reverse, reverse, hairpin)
    assert not finds(reverse, lambda tick: hairpin(tick - LATE), hairpin)


@pytest.mark.parametrize(("turned_as_asked", "told"), [(0, True), (140, False)])
def test_a_report_that_the_car_has_contradicted_is_no_reversed_steering_in_a_slide(
    turned_as_asked: int, told: bool
) -> None:
    """It turns as it is asked to for so many periods, then as the report says."""

    def mirrored(tick: int) -> float:
        return -late(tick)

    assert finds(mirrored, lambda tick: late(tick) if tick < turned_as_asked else mirrored(tick)) is told


def weave(tick: int) -> float:
    """20 deg to either side at the motor, once in a second."""
    return 0.35 * math.sin(0.02 * math.pi * tick)


@pytest.mark.parametrize("behind", [15, 26])
def test_steering_that_is_much_later_than_declared_is_not_taken_for_reversed(behind: int) -> None:
    def later(tick: int) -> float:
        return weave(tick - behind)

    assert not finds(later, later, weave)


def test_reversed_steering_is_told_although_its_sensor_is_off() -> None:
    """By 5 deg, as has been learnt; for the first second the steering works."""
    offset = math.radians(5.0)

    def steering(tick: int) -> float:
        return weave(tick - LATE) if tick < 100 else -weave(tick - LATE)

    def reported(tick: int) -> float:
        return steering(tick) + offset

    assert 100 < found_after(reported, steering, weave, zero=-offset / CAR.steering_ratio) < 160


def test_a_zero_that_is_learnt_anew_is_no_movement_of_the_report() -> None:
    """The command moves by a step of its resolution, the report follows, and the zero jumps by some."""
    rig = Rig()
    rig.run(0.05)
    state, monitor = rig.gateway.seen[0], SteeringMonitor(load_car())
    for tick in range(100):
        asked, reported = STEP_RAD * (tick > 50), STEP_RAD * (tick > 50 + LATE)
        now = state.model_copy(update={"steer": reported / CAR.steering_ratio})
        zero = -6.0 * STEP_RAD * (tick > 60) / CAR.steering_ratio
        monitor.step(now, TURNS, SPEED, ActuatorPositions(asked, 0.0, 0.0, 0.0, 6), zero, keeps=False)
        assert not monitor.against


def test_reversed_steering_is_told_while_the_car_begins_to_turn() -> None:
    def reverse(tick: int) -> float:
        return -hairpin(tick - LATE)

    assert found_after(reverse, reverse, hairpin) < 25


@pytest.mark.parametrize("turned", [late, slow, stuck])
def test_steering_that_is_late_slow_or_stuck_is_not_taken_for_reversed(turned: Motor) -> None:
    assert not finds(turned, turned)


def test_a_steering_sensor_with_the_wrong_sign_does_not_reverse_the_steering() -> None:
    assert not finds(reversed_steering, late)


def imu_wrong_in_a_slide(turned: Motor) -> bool:
    """Whether the IMU is still believed when a car with this steering has begun to spin: it turns as its tyres do not
    push, and as neither wheels nor fixes say."""
    rig = Rig()
    rig.run(0.05)
    monitors, course, car = Monitors(Config(), None), Course(0.0, 0.0, 0.0, SPEED, 0.0, 0.03), TurningCar(CAR, SPEED)
    for tick in range(-200, 230):
        steer = (turned(tick) if tick >= 0 else chicane(tick)) / CAR.steering_ratio
        car.turn(steer)
        changes = {**car.reports(), "steer": steer}
        if tick >= 200:
            changes |= {"yaw_rate": 1.6, "ay": 5.0} | {
                f"wheel_speed_{wheel}": SPEED for wheel in ("fl", "fr", "rl", "rr")
            }
        state = rig.gateway.seen[0].model_copy(update={**changes, "sys_state": SysState.DRIVING})
        commanded, now_ns = ActuatorPositions(chicane(tick), 0.0, 0.0, 0.0, 3), (tick + 201) * 10_000_000
        monitors.motion.step(now_ns, state, course, commanded)
        monitors.measures(now_ns, state, None, commanded, course)
    return monitors.imu_wrong


def test_a_gyro_that_has_shown_reversed_steering_is_believed_in_the_slide_that_follows() -> None:
    assert not imu_wrong_in_a_slide(reversed_steering)
    assert imu_wrong_in_a_slide(late)


def noticed_s(reported: Motor) -> float:
    """Time from when a slow bend begins (10 deg/s at the motor, up to 7 deg) until the steering counts as stuck."""
    rig = Rig()
    rig.run(0.05)
    state, monitor, side = rig.gateway.seen[0], FollowingMonitor(load_car()), SteeringMonitor(load_car())
    for tick in range(-100, 200):
        commanded = ActuatorPositions(bend(tick), 0.0, 0.0, 0.0, 6)
        steer = round(reported(tick) / STEP_RAD) * STEP_RAD / CAR.steering_ratio
        now = state.model_copy(update={"steer": steer})
        side.step(now, TURNS, SPEED, commanded, 0.0, keeps=True)
        held_s, _ = monitor.step((tick + 101) * 10_000_000, now, commanded, side.moves, told=False)
        if held_s > 0.0:
            return 0.01 * tick
    return math.inf


STEP_RAD = math.radians(0.5)
"""resolution of the sensor"""


def bend(tick: int) -> float:
    return math.radians(min(max(0.1 * tick, 0.0), 7.0))


def test_steering_that_stands_still_in_a_slow_bend_is_noticed_within_half_a_second() -> None:
    assert noticed_s(lambda tick: 0.0) <= 0.5


@pytest.mark.parametrize(("share", "within_s"), [(0.7, math.inf), (0.25, 0.7)])
def test_steering_that_makes_most_of_its_command_is_sound_and_one_that_makes_a_quarter_is_not(
    share: float, within_s: float
) -> None:
    after_s = noticed_s(lambda tick: share * bend(tick - LATE))
    assert after_s == within_s == math.inf or after_s <= within_s < math.inf


def test_steering_that_stands_still_is_noticed_although_its_sensor_shows_more_noise_than_declared() -> None:
    assert noticed_s(lambda tick: STEP_RAD * (tick % 3 - 1)) <= 0.6


def test_a_steering_report_that_moves_against_its_command_in_a_slow_bend_is_noticed() -> None:
    assert noticed_s(lambda tick: -bend(tick - LATE)) <= 0.7


@pytest.mark.parametrize("offset_deg", [-5.0, 0.0, 5.0])
def test_steering_that_follows_late_and_with_an_offset_is_not_stuck(offset_deg: float) -> None:
    assert noticed_s(lambda tick: bend(tick - LATE) + math.radians(offset_deg)) == math.inf


def brakes_off_s(share: float, late: int) -> float:
    """Time from when the brakes are asked for 5 MPa, in 0.1 s, until a circuit counts as off: the front one makes so
    much of it, both so many periods late."""
    rig = Rig()
    rig.run(0.05)
    state, monitor = rig.gateway.seen[0], FollowingMonitor(load_car())
    for tick in range(-50, 100):
        pressed, asked = pressure(tick - late), pressure(tick)
        now = state.model_copy(update={"brake_front": share * pressed, "brake_rear": pressed})
        commanded = ActuatorPositions(0.0, 0.0, asked, asked, 6)
        _, held_s = monitor.step((tick + 51) * 10_000_000, now, commanded, moves=True, told=False)
        if held_s >= 0.1:
            return 0.01 * tick
    return math.inf


def pressure(tick: int) -> float:
    return 5e6 * min(max(0.1 * tick, 0.0), 1.0)


def test_a_weak_brake_is_noticed_within_a_third_of_a_second() -> None:
    assert brakes_off_s(0.3, 6) <= 0.33


@pytest.mark.parametrize(("share", "late"), [(1.0, 0), (1.0, 6), (1.0, 12), (0.9, 8)])
def test_brakes_that_are_quick_late_or_a_little_weak_are_sound(share: float, late: int) -> None:
    assert brakes_off_s(share, late) == math.inf


def test_play_that_swallows_a_weave_is_no_steering_that_stands() -> None:
    """1 deg at the motor to either side, of which 2 deg of play leave nothing, for 5 s."""
    rig = Rig()
    rig.run(0.05)
    state, monitor = rig.gateway.seen[0], SteeringMonitor(load_car())
    for tick in range(500):
        asked = round(math.radians(1.0) * math.sin(0.02 * math.pi * tick) / STEP_RAD) * STEP_RAD
        monitor.step(state, TURNS, SPEED, ActuatorPositions(asked, 0.0, 0.0, 0.0, 6), 0.0, keeps=False)
        assert monitor.moves
