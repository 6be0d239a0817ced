"""Steering that stands still is noticed from how the car turns; a car that is steered roughly, or slowly, is not."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable

import pytest
from support.cars.scripted_car import reported_state
from support.cars.turning_car import TurningCar

from hil_gateway.car.actuation import ActuatorPositions
from hil_gateway.car.states import SysState
from hil_gateway.config import Config
from hil_gateway.gateway.perceive.course import Course
from hil_gateway.gateway.perceive.monitors.monitors import Monitors

CONFIG = Config()
CAR = CONFIG.vehicle
DECLARED = (4, 3.0)
"""periods of dead time, Hz of the motor's control"""
SLOW, QUICK = (4, 1.5), (2, 6.0)
Motor = Callable[[int], float]


class Steering:
    """Dead time and first order, as fast as that."""

    def __init__(self, dead: int, hertz: float) -> None:
        self._asked: deque[float] = deque([0.0] * dead)
        self._share = 1.0 - math.exp(-2.0 * math.pi * hertz * 0.01)
        self.angle = 0.0

    def step(self, asked: float) -> None:
        self._asked.append(asked)
        self.angle += self._share * (self._asked.popleft() - self.angle)


def weave(hertz: float, degrees: float, phase: float = 0.0) -> Motor:
    """Commands at the motor, rad; the first 2 s grow."""
    return lambda t: min(t / 200, 1.0) * math.radians(degrees) * math.sin(0.02 * math.pi * hertz * t + phase)


def stopped_at(
    asked: Motor, speed: Motor, like: tuple[int, float] = DECLARED, *, stands: float = math.inf,
    hangs: float = math.inf, ticks: int = 1500,
) -> float:  # fmt: skip
    """Period at which the steering has been off its command for 0.1 s; from one on it `stands`, or its report hangs."""
    monitors, car, steering, held = Monitors(CONFIG, None), TurningCar(CAR, speed(0)), Steering(*like), 0.0
    before = reported_state()
    for t in range(ticks):
        car.speed = speed(t)
        if t < stands:
            steering.step(asked(t))
        held = steering.angle if t < hangs else held
        car.turn(steering.angle / CAR.steering_ratio)
        said = car.reports() | {"steer": round(math.degrees(held) / 0.5) * math.radians(0.5) / CAR.steering_ratio}
        state = before.model_copy(update={**said, "sys_state": SysState.DRIVING})
        commanded, now_ns = ActuatorPositions(asked(t), 0.0, 0.0, 0.0, 3), (t + 1) * 10_000_000
        course = Course(0.0, 0.0, 0.0, car.speed, 0.0, 0.03)
        monitors.motion.step(now_ns, state, course, commanded)
        if monitors.measures(now_ns, state, None, commanded, course)["steering_stuck"] >= 0.1:
            return t
    return math.inf


def at(speed: float) -> Motor:
    return lambda t: speed


@pytest.mark.parametrize("like", [DECLARED, SLOW, QUICK])
@pytest.mark.parametrize(("hertz", "degrees"), [(1.0, 20.0), (2.0, 20.0), (3.0, 10.0)])
def test_a_car_that_is_steered_roughly_goes_on(like: tuple[int, float], hertz: float, degrees: float) -> None:
    assert stopped_at(weave(hertz, degrees), at(50.0), like) == math.inf


@pytest.mark.parametrize("phase", [0.0, 1.0])
def test_slow_corners_between_straights_are_no_fault(phase: float) -> None:
    """From 8 to 20 m/s and back in 9 s, steered by 60 deg at the motor."""
    assert stopped_at(weave(1 / 9, 60.0, phase), lambda t: 14 + 6 * math.cos(t / 143), ticks=3600) == math.inf


@pytest.mark.parametrize("like", [DECLARED, SLOW, QUICK])
def test_steering_that_stands_still_is_noticed_within_half_a_second(like: tuple[int, float]) -> None:
    assert 1000 < stopped_at(weave(0.2, 20.0), at(50.0), like, stands=1000) <= 1050


def test_a_report_that_hangs_is_noticed_within_half_a_second() -> None:
    assert 1000 < stopped_at(weave(0.2, 20.0), at(50.0), hangs=1000) <= 1050
