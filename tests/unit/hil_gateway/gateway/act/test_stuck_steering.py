"""With steering that stands still the wheels are locked where sliding straight on keeps to the road, and only there."""

from __future__ import annotations

import math

import pytest

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
BEND = 1.0 / 200.0


def angle(curvature: float) -> float:
    """Road-wheel angle with which the car drives this curvature, rad."""
    return math.atan(curvature * (CAR.wheelbase + UNDERSTEER * SPEED**2))


def slides(track: Track | None, curvature: float, reported: float, asked: float) -> int:
    """For how many of 20 periods at the beginning of the straight the wheels are locked; the car has driven `curvature`
    until the command moved to `asked`."""
    p = OVAL.at(LONGEST_STRAIGHT)
    pose, stuck = Pose(float(p.x), float(p.y), float(p.heading), SPEED), StuckSteering(load_car(), StopConfig(), track)
    motion = moving(SPEED * curvature)
    for tick in range(100):
        stuck.watch(angle(curvature) if tick < 80 else reported, angle(curvature) if tick < 80 else asked, motion)
    locked = 0
    for _ in range(20):
        stuck.watch(reported, asked, motion)
        locked += not stuck.steers() and stuck.locks(motion, pose)
    return locked


def moving(yaw_rate: float) -> Motion:
    """At `SPEED` on level road, rad/s."""
    return Motion(SPEED, yaw_rate, SPEED * yaw_rate, understeer=UNDERSTEER)


def test_steering_that_stands_still_in_a_bend_that_ends_makes_the_car_slide_straight_on() -> None:
    assert slides(OVAL, BEND, angle(BEND), angle(-BEND)) > 10


def test_a_car_whose_steering_follows_while_its_sensor_hangs_goes_on_steering() -> None:
    assert not slides(OVAL, BEND, angle(-BEND), angle(BEND))


def test_a_car_that_goes_straight_on_a_straight_rolls() -> None:
    assert not slides(OVAL, 0.0, 0.0, angle(BEND))


def test_without_a_track_nobody_knows_where_to_slide() -> None:
    assert not slides(None, BEND, angle(BEND), angle(-BEND))


@pytest.mark.parametrize(
    ("share", "offset", "steers"), [(1.0, 0.0175, True), (0.0, 0.0175, False), (0.1, 0.0, False), (-1.0, 0.0, False)]
)
def test_steering_whose_report_moves_with_its_command_steers_whatever_its_offset(
    share: float, offset: float, steers: bool
) -> None:
    """The report is 60 ms late; the car turns as it did before the command moved, so its yaw rate decides nothing."""
    unknown = Motion(SPEED, 0.2, SPEED * 0.2, by_gyro=False)
    stuck, asked = StuckSteering(load_car(), StopConfig(), OVAL), [0.02 - 0.0002 * tick for tick in range(100)]
    for late, angle_now in zip([asked[0]] * 6 + asked, asked, strict=False):
        stuck.watch(asked[0] + share * (late - asked[0]) + offset, angle_now, unknown)
    assert stuck.steers() is steers


@pytest.mark.parametrize(("share", "more"), [(0.3, 0.0), (0.75, 0.08)])
def test_a_car_that_has_not_turned_yet_with_a_command_that_jumps_goes_on_steering(share: float, more: float) -> None:
    """The report hangs; the command of the stop jumps, which the car answers 0.1 s late and with its turn-in, turning
    by `more` (rad/s) than its angle means on level road: on a bank, where it feels less force."""
    asked = [angle(BEND)] * 100 + [angle(share * BEND)] * 60
    p = OVAL.at(LONGEST_STRAIGHT)
    pose, stuck = Pose(float(p.x), float(p.y), float(p.heading), SPEED), StuckSteering(load_car(), StopConfig(), OVAL)
    yaw_rate, steers, locked = SPEED * BEND + more, False, False
    for tick, asked_now in enumerate(asked):
        if tick > 100:
            yaw_rate += 0.1 * (SPEED * BEND * (1.0 if tick < 110 else share) + more - yaw_rate)
        felt = SPEED * (yaw_rate - more) - CAR.wheelbase * more / (SPEED * UNDERSTEER)
        motion = moving(yaw_rate)._replace(ay=felt)
        stuck.watch(asked[0], asked_now, motion)
        if tick > 100:
            steers = stuck.steers()
            locked = locked or (not steers and stuck.locks(motion, pose))
    assert not locked
    assert steers, "in the end the yaw rate says that the steering works"


@pytest.mark.parametrize(("share", "stands"), [(0.0, True), (-1.0, False), (0.7, False)])
def test_steering_that_moves_does_not_stand_still(share: float, stands: bool) -> None:
    """The car turns by the angle that is reported, which moves by `share` of its command."""
    stuck = StuckSteering(load_car(), StopConfig(), OVAL)
    for tick in range(120):
        asked = 0.02 - 2e-4 * max(tick - 50, 0)
        reported = 0.02 + share * (asked - 0.02)
        motion = moving(SPEED * math.tan(reported) / (CAR.wheelbase + UNDERSTEER * SPEED**2))
        stuck.watch(reported, asked, motion)
        stuck.steers()
    assert stuck.stands is stands
