"""Both axles in numbers of now: where the car will be, and which angle turns it as wanted."""

from __future__ import annotations

import math

import pytest
from support.cars.turning_car import ObservedCar

from hil_gateway.car.car import load_car
from hil_gateway.observer.axles import Axle, Axles

VEHICLE = load_car().vehicle
SPEED = 60.0
SLIDES = Axles(VEHICLE, Axle(22.0, 0.08, 0.0), Axle(14.0, 0.08, 0.0), SPEED, -15.0, 0.4, 0.0, 0.0)
"""its rear axle gives all that it has"""


def observed(steer: float, seconds: float = 4.0) -> tuple[ObservedCar, Axles]:
    """A car that has turned by this road-wheel angle (rad), and what the observer knows of it."""
    car = ObservedCar(SPEED)
    for _ in range(round(100 * seconds)):
        car.step(steer, steer, steer)
    axles = car.observer.axles
    assert axles is not None
    return car, axles


@pytest.mark.parametrize("curvature", [0.0, 2e-3, -3e-3])
def test_the_angle_that_changes_nothing_is_the_one_it_turns_by(curvature):
    steer = ObservedCar(SPEED).car.angle(curvature)
    _, axles = observed(steer)
    assert axles.steered(0.0) == pytest.approx(steer, abs=1e-3)


@pytest.mark.parametrize("curvature", [2e-3, -3e-3])
def test_side_slip_is_known(curvature):
    car, _ = observed(ObservedCar(SPEED).car.angle(curvature))
    assert abs(car.car.side_speed) > 0.5
    assert car.observer.slip == pytest.approx(car.car.side_speed / SPEED, abs=6e-3)


def test_it_goes_on_as_the_car_does():
    steer = ObservedCar(SPEED).car.angle(2e-3)
    car, axles = observed(steer)
    angles, before = [steer + 0.01 * i / 12 for i in range(12)], car.car.yaw_rate
    ahead = axles.onward(angles)
    for angle in angles:
        car.step(angle, angle, angle)
    changed = car.car.yaw_rate - before
    assert changed > 0.05
    assert ahead.yaw_rate - axles.yaw_rate == pytest.approx(changed, rel=0.15)
    assert ahead.side_speed == pytest.approx(car.car.side_speed, abs=0.1)


def test_a_car_that_slides_is_steered_into_its_slide():
    further = SLIDES._replace(side_speed=SLIDES.side_speed - 3.0)
    assert further.steered(0.0) == pytest.approx(SLIDES.steered(0.0) - 3.0 / SPEED, abs=1e-3)


def test_a_slide_is_ended_by_the_angle_that_turns_the_car_back():
    back = SLIDES.onward([SLIDES.steered(-4.0)])
    assert (back.yaw_rate - SLIDES.yaw_rate) / 0.01 == pytest.approx(-4.0, rel=0.01)


def test_more_force_than_the_front_axle_has_takes_no_endless_angle():
    most = Axle(20.0, 0.08, 1.0)
    assert most.angle(1e3) == -Axle(20.0, 0.08, -1.0).angle(-1e3)
    assert most.force(most.angle(1e3)) == pytest.approx(0.954 * 20.0 + 1.0, rel=1e-3)
    assert math.isfinite(SLIDES.steered(math.inf))


def test_the_told_angle_is_the_one_that_counts():
    """A report that hangs: the filter that takes it for true is led astray, that of the command is not."""
    car, _ = observed(0.0, 3.0)
    for i in range(120):
        angle = car.car.angle(2.5e-3 * min(i / 40.0, 1.0))
        car.step(angle, 0.0, angle)
    axles = car.observer.axles
    assert car.observer.steering.as_asked
    assert axles is not None
    assert axles.steered(0.0) == pytest.approx(angle, abs=2e-3)


def test_a_slow_car_is_not_known():
    car = ObservedCar(5.0)
    car.step(0.0, 0.0, 0.0)
    assert car.observer.axles is None
