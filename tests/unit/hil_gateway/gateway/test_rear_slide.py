"""A rear axle that slides is let go, and only that."""

from __future__ import annotations

import pytest

from hil_gateway.gateway.act.rear_slide import LEAST_PRESSURE, PRESS_AGAIN, RearSlide
from hil_gateway.gateway.perceive.motion import Motion

MOST, SPEED, FORCE = 6e6, 40.0, 12.0


def rear_most(faster: float, side: float = 1.0, by_gyro: bool = True) -> float:
    """Pa after 0.4 s in a bend to one side in which the car turns by `faster` (rad/s) than its force makes it."""
    slide, ay = RearSlide(MOST), side * FORCE
    for _ in range(40):
        slide.step(Motion(SPEED, ay / SPEED + side * faster, ay, by_gyro))
    return slide.rear_most


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_car_that_turns_faster_than_it_is_pushed_aside_has_its_rear_axle_let_go(side: float) -> None:
    assert rear_most(0.15, side) == LEAST_PRESSURE


@pytest.mark.parametrize("faster", [0.0, 0.04, -0.15])
def test_a_car_that_turns_as_it_is_pushed_or_pushes_over_its_front_axle_brakes_with_both(faster: float) -> None:
    assert rear_most(faster) == MOST


def test_without_a_gyro_no_slide_is_told() -> None:
    assert rear_most(0.15, by_gyro=False) == MOST


def test_it_presses_again_slowly_once_it_grips() -> None:
    slide = RearSlide(MOST)
    for _ in range(40):
        slide.step(Motion(SPEED, FORCE / SPEED + 0.15, FORCE))
    for _ in range(100):
        slide.step(Motion(SPEED, FORCE / SPEED, FORCE))
    assert LEAST_PRESSURE < slide.rear_most <= LEAST_PRESSURE + PRESS_AGAIN
