"""Where the car is while nobody estimates it."""

from __future__ import annotations

import math
from typing import Any

import pytest
from support.cars.scripted_car import Rig

from hil_gateway.bus.messages import Estimate, VehicleState
from hil_gateway.gateway.perceive.dead_reckoning import DeadReckoning, Pose
from hil_gateway.gateway.perceive.duration import UNSEEN_S
from hil_gateway.gateway.perceive.motion import Motion

TICK_NS = 10_000_000


@pytest.fixture(scope="module")
def rig() -> Rig:
    made = Rig()
    made.run(0.2)
    return made


def state(rig: Rig, speed: float = 40.0, **changed: Any) -> VehicleState:
    speeds = dict.fromkeys(("wheel_speed_fl", "wheel_speed_fr", "wheel_speed_rl", "wheel_speed_rr"), speed)
    fixes = {"position_seq": 0, "position_stamp_ns": rig.now_ns}
    return rig.gateway.builder.build(rig.now_ns, 9, 1, 0).model_copy(update={**speeds, **fixes, **changed})


def estimate(rig: Rig, **changed: Any) -> Estimate:
    start = {"x": 0.0, "y": 0.0, "yaw": 0.0, "vx": 40.0, "state_stamp_ns": rig.now_ns}
    return rig.estimate(0).model_copy(update={**start, **changed})


AHEAD = Motion(speed=40.0)


def circle(rig: Rig, seconds: float, fixes: dict[int, tuple[float, float]] | None = None) -> Pose:
    """Pose after driving a circle at 40 m/s and 0.2 rad/s, estimated only at the beginning; fixes by tick."""
    reckoning, seq = DeadReckoning(0.02), 0
    pose = reckoning.step(rig.now_ns, state(rig), AHEAD, estimate(rig))
    for tick in range(1, round(seconds * 100) + 1):
        seq += tick in (fixes or {})
        x, y = (fixes or {}).get(tick, (0.0, 0.0))
        now_ns = rig.now_ns + tick * TICK_NS
        reported = state(rig, position_seq=seq, position_x=x, position_y=y, position_stamp_ns=now_ns)
        pose = reckoning.step(now_ns, reported, Motion(40.0, 0.2), None)
    assert pose is not None
    return pose


def on_circle(seconds: float, aside: float = 0.0) -> tuple[float, float]:
    """Exact position on that circle (radius 200 m), `aside` m to the right of it."""
    angle, radius = 0.2 * seconds, 200.0 + aside
    return radius * math.sin(angle), 200.0 - radius * math.cos(angle)


def test_nothing_is_known_before_the_first_estimate(rig):
    assert DeadReckoning(0.02).step(rig.now_ns, state(rig), AHEAD, None) is None


def test_the_pose_is_carried_on_along_a_circle(rig):
    pose = circle(rig, 2.0)
    assert (pose.x, pose.y) == pytest.approx(on_circle(2.0), abs=0.01)
    assert pose.yaw == pytest.approx(0.4)


def test_an_estimate_is_carried_on_from_the_moment_it_speaks_of(rig):
    """Late by 80 ms at 40 m/s it would be 3.2 m behind, also while it is repeated."""
    reckoning, late = DeadReckoning(0.02), estimate(rig)
    for tick in range(9):
        pose = reckoning.step(rig.now_ns + tick * TICK_NS, state(rig), AHEAD, late)
    assert pose is not None and pose.x == pytest.approx(3.2)


def test_fixes_hold_a_drift_that_wheels_and_gyro_do_not_see(rig):
    """Side slip takes the car outwards by 1 m/s; a fix every 50 ms says so."""
    fixes = {tick: on_circle(tick / 100, tick / 100) for tick in range(5, 301, 5)}
    x, y = on_circle(3.0, 3.0)
    blind, helped = circle(rig, 3.0), circle(rig, 3.0, fixes)
    assert math.hypot(blind.x - x, blind.y - y) == pytest.approx(3.0, abs=0.1)
    assert math.hypot(helped.x - x, helped.y - y) < 0.2


def test_a_fix_that_came_a_while_ago_says_where_the_car_was_then(rig):
    """9 ms at 40 m/s are 0.36 m, of which a fix that is taken for one of now would take most."""
    reckoning = DeadReckoning(0.02)
    reckoning.step(rig.now_ns, state(rig), AHEAD, estimate(rig))
    came_ns = rig.now_ns + 100 * TICK_NS
    told = state(rig, position_seq=1, position_x=40.0, position_y=0.0, position_stamp_ns=came_ns)
    for tick in range(1, 100):
        reckoning.step(rig.now_ns + tick * TICK_NS, state(rig), AHEAD, None)
    pose = reckoning.step(came_ns + 9 * TICK_NS // 10, told, AHEAD, None)
    assert pose is not None and pose.x == pytest.approx(40.36)


def test_after_a_long_way_without_a_fix_a_distant_one_is_taken(rig):
    """Blind for 120 m the pose may be metres off: what would be a jump at once is news then."""
    x, y = on_circle(3.0)
    far, pose = (x + 6.0, y), circle(rig, 3.0)
    helped = circle(rig, 3.0, {300: far})
    assert math.hypot(helped.x - far[0], helped.y - far[1]) < math.hypot(pose.x - far[0], pose.y - far[1]) - 1.0


@pytest.mark.parametrize("stamp", [1, 1 << 62])
def test_an_estimate_with_an_absurd_stamp_moves_the_pose_by_little(rig, stamp):
    pose = DeadReckoning(0.02).step(rig.now_ns, state(rig), AHEAD, estimate(rig, state_stamp_ns=stamp))
    assert pose is not None and 0 <= pose.x <= 40.0 * UNSEEN_S + 1e-9


@pytest.mark.parametrize(("speed", "taken"), [(40.0, False), (0.0, True)])
def test_a_heading_that_is_a_guess_replaces_none_that_was_reckoned_of_a_car_that_moves(rig, speed, taken):
    reckoning = DeadReckoning(0.02)
    reckoning.step(rig.now_ns, state(rig), AHEAD, estimate(rig))
    later = rig.now_ns + TICK_NS
    guess = estimate(rig, yaw=0.3, valid=False, lacks="heading", state_stamp_ns=later)
    pose = reckoning.step(later, state(rig, speed), Motion(speed=speed), guess)
    assert pose is not None
    assert (pose.yaw == pytest.approx(0.3)) is taken


def test_nothing_is_known_after_a_long_gap_until_there_is_an_estimate_with_its_heading(rig):
    reckoning = DeadReckoning(0.02)
    reckoning.step(rig.now_ns, state(rig), AHEAD, estimate(rig))
    later = rig.now_ns + 150 * TICK_NS
    guess = estimate(rig, valid=False, lacks="heading", state_stamp_ns=later)
    assert reckoning.step(later, state(rig), AHEAD, guess) is None
    assert reckoning.step(later, state(rig), AHEAD, estimate(rig, state_stamp_ns=later)) is not None


def test_a_new_estimate_replaces_what_was_reckoned(rig):
    reckoning = DeadReckoning(0.02)
    reckoning.step(rig.now_ns, state(rig), AHEAD, estimate(rig))
    later = rig.now_ns + 50 * TICK_NS
    pose = reckoning.step(later, state(rig), AHEAD, estimate(rig, x=7.0, y=1.0, state_stamp_ns=later))
    assert pose == Pose(7.0, 1.0, 0.0, 40.0)


def test_fixes_that_are_not_believed_do_not_move_the_pose(rig):
    reckoning = DeadReckoning(0.02)
    reckoning.step(rig.now_ns, state(rig), AHEAD, estimate(rig))
    beside = state(rig, position_seq=1, position_x=0.4, position_y=1.0)
    pose = reckoning.step(rig.now_ns + TICK_NS, beside, AHEAD, None, believe_fixes=False)
    assert pose == Pose(pytest.approx(0.4), 0.0, 0.0, 40.0)
    later = state(rig, position_seq=2, position_x=0.8, position_y=1.0)
    pose = reckoning.step(rig.now_ns + 2 * TICK_NS, later, AHEAD, None)
    assert pose is not None and pose.y > 0.0


def test_a_car_whose_gyro_is_lost_still_goes_where_it_went(rig):
    """At 66 m/s in a bend it slips by 2.4 degrees: left out, that leads 1 m aside in 0.4 s."""
    reckoning, bend = DeadReckoning(0.02), Motion(66.0, 0.25, 16.0, slip=-0.04)
    now_ns = rig.now_ns
    for _ in range(500):
        now_ns += TICK_NS
        reckoning.step(now_ns, state(rig), bend, estimate(rig, vx=66.0, yaw_rate=0.25, state_stamp_ns=now_ns))
    before = reckoning.pose
    assert before is not None and before.slip == bend.slip
    for by_gyro in (False, True):
        now_ns += TICK_NS
        pose = reckoning.step(now_ns, state(rig), Motion(66.0, 0.0, 16.0 * by_gyro, by_gyro=by_gyro), None)
        assert pose is not None
        course = math.atan2(pose.y - before.y, pose.x - before.x)
        assert course == pytest.approx(before.yaw + before.slip, abs=1e-3)
        before = pose
