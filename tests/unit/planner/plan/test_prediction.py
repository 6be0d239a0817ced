"""Latency compensation: the plan starts where the car will be, and the command leads the actuators' lag."""

from __future__ import annotations

import math

import numpy as np
import pytest

from benchmarks.plans.bench import bench_controller
from hil_gateway.car.car import load_car
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.track.loading import load_track
from planner.plan.controller import Controller
from planner.plan.prediction import ActuatorModel, Car, Held, Late, PredictedMoment, Sent, credible, predict
from planner.problem.settings import declared_settings

MS = NS_PER_S // 1000


def _still(car: Car, held: list[Held]) -> Car:
    return (car[0] + car[3] * sum(duration for _, _, duration in held), *car[1:])


def test_a_command_acts_after_the_dead_time() -> None:
    actuators = ActuatorModel(load_car().actuators)
    actuators.record(Sent(0, 0.1, 0.0))
    actuators.record(Sent(100 * MS, 0.2, 0.0))
    assert actuators.input_at(39 * MS) is None
    acting = [actuators.input_at(t * MS) for t in (40, 139, 140)]
    assert [a.steer for a in acting if a] == [0.1, 0.1, 0.2]


def test_prediction_follows_the_first_order_lag() -> None:
    actuators = ActuatorModel(load_car().actuators)
    actuators.record(Sent(-NS_PER_S, 0.1, -0.05))
    then = predict(actuators, _still, PredictedMoment(0, (0.0, 0.0, 0.0, 30.0, 0.0, 0.0), 0.0, 0.0), 55 * MS)
    assert then.at_ns == 55 * MS
    assert then.car[0] == pytest.approx(30.0 * 0.055)
    assert then.steer == pytest.approx(0.1 * (1 - math.exp(-0.055 * 2 * math.pi * 3)), rel=1e-9)
    assert then.drive == pytest.approx(-0.05 * (1 - math.exp(-0.055 * 2 * math.pi * 5)), rel=1e-9)


def test_a_late_drive_command_acts_as_it_was_reported_before() -> None:
    actuators, late = ActuatorModel(load_car().actuators), Late(drive=0.1)
    actuators.record(Sent(-NS_PER_S, 0.0, -0.2))
    for at_ns, reported in ((0, 0.0), (50 * MS, -0.1), (100 * MS, -0.2)):
        then = predict(actuators, _still, PredictedMoment(at_ns, (0.0,) * 6, reported, 0.0), at_ns + 30 * MS, late)
    assert then.drive == pytest.approx(-0.2 * (1.0 - math.exp(-0.03 * 2 * math.pi * 5)), rel=1e-9), "130 - 100 ms"
    assert actuators.drive_course.at(50 * MS) == -0.1, "what is reported takes the place of what was expected"


def test_late_road_wheels_turn_the_car_as_was_reported_before() -> None:
    actuators, steered = ActuatorModel(load_car().actuators), []

    def advance(car: Car, held: list[Held]) -> Car:
        steered.extend(steer for _, steer, _ in held)
        return car

    for at_ms in range(0, 110, 10):
        before = PredictedMoment(at_ms * MS, (0.0,) * 6, 0.0, 1e-3 * at_ms)
        steered.clear()
        then = predict(actuators, advance, before, (at_ms + 40) * MS, Late(steer=0.06))
    assert steered == pytest.approx([0.045, 0.055, 0.065, 0.075]), "what was reported 60 ms before"
    assert then.steer == pytest.approx(0.08)


def test_without_any_command_the_actuators_stay() -> None:
    then = predict(ActuatorModel(load_car().actuators), _still, PredictedMoment(0, (0.0,) * 6, 0.02, 0.01), 50 * MS)
    assert (then.drive, then.steer) == (0.02, 0.01)


def test_lead_brings_the_lagging_actuator_where_the_plan_wants_it() -> None:
    actuators = ActuatorModel(load_car().actuators)
    command = actuators.lead(0.02, 0.03, 0.05, actuators.steer_lag)
    actuators.record(Sent(-NS_PER_S, command, 0.0))
    assert actuators.follow(0.0, 0.02, 0, 0.05)[1] == pytest.approx(0.03, rel=1e-9)


@pytest.fixture(scope="module")
def controller() -> Controller:
    return bench_controller(load_track(), load_car().vehicle, declared_settings(load_car()))[0]


def test_braking_does_not_push_a_standing_car_backwards(controller: Controller) -> None:
    held = [(-0.3, 0.0, 0.01)] * 30
    for speed in (-0.1, 0.0, 0.05, 0.5):
        car = controller.advance((0.0, 0.0, 0.0, speed, 0.0, 0.0), held)
        assert 0.0 <= car[3] < 0.01
        assert -0.01 < car[0] < 0.1


def test_a_long_prediction_is_many_short_ones(controller: Controller) -> None:
    """However many steps one call of the compiled function takes."""
    actuators = ActuatorModel(load_car().actuators)
    actuators.record(Sent(-NS_PER_S, 0.05, -0.1))
    start = PredictedMoment(0, (0.0, 0.0, 0.3, 30.0, 0.5, 0.1), 0.0, 0.0)
    at_once = predict(actuators, controller.advance, start, 205 * MS)
    then = start
    for end in (*range(10, 210, 10), 205):
        then = predict(actuators, controller.advance, then, end * MS)
    np.testing.assert_allclose(then.car, at_once.car, rtol=1e-9)
    assert at_once.car[3] < 30.0


def test_a_state_that_is_no_number_stays_none(controller: Controller) -> None:
    assert math.isnan(controller.advance((0.0, 0.0, 0.0, math.nan, 0.0, 0.0), [(0.0, 0.0, 0.01)])[3])


@pytest.mark.parametrize(
    ("changed", "value", "can_be"),
    [(0, 600.0, True), (0, 1e7, False), (1, -1e7, False), (0, math.nan, False), (2, math.inf, False), (3, 85.0, True),
     (3, 9e3, False), (4, -9e3, False), (5, 9e3, False), (5, math.nan, False)],
)  # fmt: skip
def test_a_state_that_no_car_can_be_in_is_not_planned_from(changed: int, value: float, can_be: bool) -> None:
    track = load_track("oval")
    car = [float(track.x[0]), float(track.y[0]), 3.0, 60.0, -1.0, 0.3]
    car[changed] = value
    assert credible(tuple(car), track) is can_be
