"""With steering that stands still the wheels are locked where sliding straight on keeps to the road, and only there."""

from __future__ import annotations

import math

import pytest
from support.cars.turning_car import ObservedCar, TurningCar

from hil_gateway.car.car import load_car
from hil_gateway.gateway.act.stuck_steering import StuckSteering
from hil_gateway.gateway.perceive.dead_reckoning import Pose
from hil_gateway.gateway.perceive.motion import UNDERSTEER, Motion
from hil_gateway.settings.gateway import StopConfig
from hil_gateway.track.loading import load_track
from hil_gateway.track.track import Track

CAR, SPEED = load_car().vehicle, 60.0
OVAL = load_track("oval")
LONGEST_STRAIGHT = max(
    (s for s in range(0, int(OVAL.length), 5)),
    key=lambda s: next(d for d in range(0, 2000, 5) if abs(OVAL.at(s + d).curvature) > 1e-4),
)
"""where the longest straight of the track begins, m"""
BEND = 1.0 / 400.0


def angle(curvature: float) -> float:
    """Road-wheel angle with which the car drives this curvature, rad."""
    return TurningCar(CAR, SPEED).angle(curvature)


def driven(asked: float) -> ObservedCar:
    """A car that has steered around this angle for 4 s, rad, and is known."""
    car = ObservedCar(SPEED, CAR.pressed(SPEED) * load_car().tyres.grip)
    for tick in range(400):
        angle_now = asked + 0.003 * math.sin(0.02 * math.pi * tick)
        car.step(angle_now, angle_now, angle_now)
    return car


def slides(track: Track | None, curvature: float, asked: float, *, turns: bool = False) -> int:
    """For how many of 20 periods at the beginning of the straight the wheels are locked; the car has driven `curvature`
    until the command moved to `asked`, half a second ago. The report hangs, and the steering unless the car `turns`."""
    p, held = OVAL.at(LONGEST_STRAIGHT), angle(curvature)
    pose, stuck = Pose(float(p.x), float(p.y), float(p.heading), SPEED), StuckSteering(load_car(), StopConfig(), track)
    car, locked = driven(held), 0
    for tick in range(150):
        wanted = held if tick < 80 else held + min(0.05 * (tick - 80), 1.0) * (asked - held)
        hypotheses = car.step(wanted, held, wanted if turns else held)
        if tick >= 130:
            stuck.judge(hypotheses, still=wanted != held)
            locked += stuck.locks(moving(SPEED * curvature), pose, held)
    return locked


def moving(yaw_rate: float) -> Motion:
    """At `SPEED` on level road, rad/s."""
    return Motion(SPEED, yaw_rate, SPEED * yaw_rate, understeer=UNDERSTEER)


def test_steering_that_stands_still_in_a_bend_that_ends_makes_the_car_slide_straight_on() -> None:
    assert slides(OVAL, BEND, angle(-BEND)) > 10


def test_a_car_whose_steering_follows_while_its_sensor_hangs_goes_on_steering() -> None:
    assert not slides(OVAL, BEND, angle(-BEND), turns=True)


def test_a_car_that_goes_straight_on_a_straight_rolls() -> None:
    assert not slides(OVAL, 0.0, angle(BEND))


def test_without_a_track_nobody_knows_where_to_slide() -> None:
    assert not slides(None, BEND, angle(-BEND))


@pytest.mark.parametrize(("share", "tells"), [(0.3, True), (0.75, False)])
def test_a_car_that_has_not_turned_yet_with_a_command_that_jumps_goes_on_steering(share: float, tells: bool) -> None:
    """The report hangs; the command of the stop jumps, which the car answers 0.1 s late; a small jump tells nothing."""
    p, before = OVAL.at(LONGEST_STRAIGHT), angle(BEND)
    pose, stuck = Pose(float(p.x), float(p.y), float(p.heading), SPEED), StuckSteering(load_car(), StopConfig(), OVAL)
    car, told, locked = driven(before), False, False
    for tick in range(60):
        turned = before if tick < 10 else share * before
        hypotheses = car.step(share * before, before, turned)
        stuck.judge(hypotheses, still=True)
        locked = locked or stuck.locks(moving(car.car.yaw_rate), pose, before)
        told = hypotheses.as_asked
    assert not locked
    assert not stuck.stands
    assert told is tells


@pytest.mark.parametrize("still", [True, False])
def test_a_car_that_turns_by_a_report_that_moves_steers(still: bool) -> None:
    before = angle(BEND)
    stuck, car = StuckSteering(load_car(), StopConfig(), OVAL), driven(before)
    for tick in range(140):
        stuck.judge(car.step(before - 2e-4 * max(tick - 50, 0), before, before), still=still)
    assert stuck.stands is still
