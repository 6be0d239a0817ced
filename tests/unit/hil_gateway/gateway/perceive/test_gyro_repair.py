"""A gyro with what it is wrong by taken back."""

from __future__ import annotations

import pytest

from hil_gateway.gateway.perceive.course import COURSE_WINDOW, Course
from hil_gateway.gateway.perceive.gyro_repair import APART, GyroRepair, RepairedGyro

OFFSET = GyroRepair(offset=0.3)


def rates(
    repair: GyroRepair, reading: float, turn_rate: float | None, periods: int = 2 * COURSE_WINDOW, noise: float = 0.0
) -> list[float | None]:
    gyro, course = RepairedGyro(), None if turn_rate is None else turning(turn_rate, noise)
    return [gyro.step(repair, reading, course) for _ in range(periods)]


def turning(turn_rate: float, noise: float = 0.0) -> Course:
    return Course(0.0, 0.0, 0.0, 40.0, turn_rate, noise, 0.0)


@pytest.mark.parametrize(("repair", "reading"), [(OFFSET, 0.5), (GyroRepair(sign=-1.0), -0.2), (GyroRepair(), 0.2)])
def test_it_shows_what_the_car_does(repair, reading):
    assert rates(repair, reading, 0.2) == pytest.approx([0.2] * 2 * COURSE_WINDOW)


def test_fixes_that_contradict_its_first_rates_refute_it():
    shown = rates(OFFSET, 0.5, 0.2 + 1.1 * APART)
    assert shown[0] is not None
    assert shown[COURSE_WINDOW:] == [None] * COURSE_WINDOW


def test_fixes_whose_noise_turns_them_refute_nothing():
    assert None not in rates(OFFSET, 0.5, 0.2 + 1.1 * APART, noise=0.1)


def test_a_car_that_spins_later_refutes_nothing():
    """Its course turns less than it does."""
    gyro = RepairedGyro()
    for _ in range(COURSE_WINDOW):
        gyro.step(OFFSET, 0.5, turning(0.2))
    assert gyro.step(OFFSET, 1.8, turning(0.2)) == pytest.approx(1.5)


def test_without_fixes_it_counts_alone():
    assert None not in rates(OFFSET, 0.5, None)


def test_what_does_not_arrive_shows_nothing_and_is_judged_anew():
    gyro = RepairedGyro()
    for _ in range(COURSE_WINDOW):
        gyro.step(OFFSET, 0.5, turning(0.2))
    assert gyro.step(OFFSET, None, turning(0.2)) is None
    for _ in range(COURSE_WINDOW):
        shown = gyro.step(OFFSET, 1.5, turning(0.2))
    assert shown is None
