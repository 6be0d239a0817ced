"""By which angle the car turns is told from how it turns, and a car that answers late is not taken for a fault."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
from support.cars.turning_car import ObservedCar

from hil_gateway.observer.steering import SteeringHypotheses

SPEED = 60.0
LATE = 8
"""periods, as declared"""
Angle = Callable[[int], float]


def weave(tick: int) -> float:
    """Road-wheel angle, rad: chicanes of 5 s."""
    return 0.012 * math.sin(0.012 * tick)


def bend(tick: int) -> float:
    """The same until it stops at 10 s, then a bend that begins slowly, 0.7 deg/s."""
    return weave(tick) if tick < 1000 else weave(1000) + 1.2e-4 * (tick - 1000)


def drive(asked: Angle, reported: Angle, turned: Angle, ticks: int = 1000) -> tuple[SteeringHypotheses, float]:
    """What is told in the end, and the largest share of chance that it came to."""
    car, most = ObservedCar(SPEED), 0.0
    told = car.observer.steering
    for tick in range(ticks):
        told = car.step(asked(tick), reported(tick), turned(tick))
        most = max(most, told.off)
    return told, most


@pytest.mark.parametrize("late", [0, 8, 14])
@pytest.mark.parametrize("zero", [0.0, 0.004])
def test_steering_that_answers_sooner_or_later_than_declared_is_no_fault(late: int, zero: float) -> None:
    """With a zero of 0.23 deg."""
    _, most = drive(weave, lambda tick: weave(tick - late), lambda tick: weave(tick - late) + zero)
    assert most < 1.0


def test_a_command_that_is_off_its_report_is_no_fault_again_and_again() -> None:
    """By 5 deg at the motor; every 10 s the car does not obey for a while."""
    car, most = ObservedCar(SPEED), 0.0
    for tick in range(4000):
        steering = car.step(weave(tick), weave(tick - LATE) + 0.0055, weave(tick - LATE))
        if tick % 1000 == 999:
            steering.forget()
        most = max(most, steering.off)
    assert most < 1.0


def test_play_is_no_fault() -> None:
    """0.6 deg at the motor."""
    still = 0.0

    def played(tick: int) -> float:
        nonlocal still
        still = min(max(still, weave(tick - LATE) - 3e-4), weave(tick - LATE) + 3e-4)
        return still

    car, most = ObservedCar(SPEED), 0.0
    for tick in range(1000):
        angle = played(tick)
        most = max(most, car.step(weave(tick), angle, angle).off)
    assert most < 1.0


def stuck(tick: int) -> float:
    return bend(min(tick, 1000) - LATE)


def following(tick: int) -> float:
    return bend(tick - LATE)


def test_steering_that_stands_still_is_told_as_the_bend_begins() -> None:
    told, most = drive(bend, stuck, stuck, ticks=1165)
    assert told.as_reported
    assert most > 1.0


def test_a_report_that_hangs_is_told_from_steering_that_does() -> None:
    told, most = drive(bend, stuck, following, ticks=1090)
    assert told.as_asked
    assert most > 1.0


def test_nothing_is_told_of_a_car_that_does_not_obey() -> None:
    """Until 11 s it does, and its steering stands still."""
    car = ObservedCar(SPEED)
    for tick in range(1200):
        told = car.step(bend(tick), stuck(tick), stuck(tick), obeys=tick < 1165)
        if tick == 1164:
            assert told.as_reported
    assert not told.as_reported
