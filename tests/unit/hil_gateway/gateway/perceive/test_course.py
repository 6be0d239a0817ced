"""How the car moves by its position fixes alone, and the sensors judged by that."""

from __future__ import annotations

import math

import numpy as np
import pytest
from support.cars.scripted_car import Rig

from hil_gateway.gateway.perceive.course import Course
from hil_gateway.gateway.perceive.dead_reckoning import DeadReckoning, Pose, Reckoned
from hil_gateway.gateway.perceive.monitors.position import PositionMonitor
from hil_gateway.gateway.perceive.motion import Motion
from hil_gateway.gateway.perceive.positions.fixes import Fixes

TICK_NS = 10_000_000
RADIUS, SPEED = 150.0, 45.0
TURN = SPEED / RADIUS


@pytest.fixture(scope="module")
def rig() -> Rig:
    made = Rig()
    made.run(0.2)
    return made


def circle(
    seconds: float,
    *,
    noise: float = 0.02,
    seed: int = 1,
    lost_from: float = math.inf,
    speed: float = SPEED,
    every: int = 5,
) -> Course | None:
    """Course after a circle with a fix in `every` so many periods; the newest one of 20 Hz is 20 ms old."""
    rng, fixes, course = np.random.default_rng(seed), Fixes(0.02), None
    for tick in range(1, round(seconds * 100) + 1):
        t = 0.01 * tick
        if tick % every == 3 * every // 5 and t < lost_from:
            turned = speed / RADIUS * t
            x, y = RADIUS * math.sin(turned), RADIUS * (1 - math.cos(turned))
            fixes.take(x + noise * rng.standard_normal(), y + noise * rng.standard_normal(), tick * TICK_NS)
        course = fixes.course(tick * TICK_NS)
    return course


@pytest.mark.parametrize("every", [1, 5, 10, 20])
@pytest.mark.parametrize("seed", range(20))
def test_the_course_on_a_circle_is_that_of_the_circle(seed, every):
    course = circle(2.0, seed=seed, every=every)
    assert course is not None
    assert abs(math.remainder(course.course - 2.0 * TURN, 2 * math.pi)) < 0.03
    assert course.speed == pytest.approx(SPEED, abs=1.2)
    assert course.turn_rate == pytest.approx(TURN, abs=0.12)
    assert math.hypot(course.x - RADIUS * math.sin(2.0 * TURN), course.y - RADIUS * (1 - math.cos(2.0 * TURN))) < 0.15


def test_without_recent_fixes_there_is_no_course():
    assert circle(0.3) is None
    assert circle(2.0, lost_from=1.8) is None


def test_a_car_is_not_seen_to_move_before_there_are_fixes_that_tell():
    """Else wheels that stand would be called dead."""
    fixes = Fixes(0.02)
    seen = [fixes.moving]
    for tick in range(1, 13):
        fixes.take(SPEED * 0.05 * tick, 0.0, 5 * tick * TICK_NS)
        seen.append(fixes.moving)
    assert seen[-1] and seen.index(True) > 8


def test_fixes_are_kept_for_as_long_as_other_receivers_are_late():
    fixes = Fixes(0.02, late_s=6.0)
    for tick in range(1, 200):
        fixes.take(SPEED * 0.05 * tick, 0.0, 5 * tick * TICK_NS)
    times, _ = fixes.line()
    assert times[-1] - times[0] > 6.0


def test_scattered_fixes_are_no_course():
    assert circle(2.0, noise=1.0) is None


def test_a_reckoning_that_restarts_goes_on_from_the_fixes(rig):
    reckoning = DeadReckoning(0.02)
    start = rig.estimate(0).model_copy(
        update={"x": 0.0, "y": 0.0, "yaw": 0.5, "vx": 40.0, "state_stamp_ns": rig.now_ns}
    )
    standing = rig.gateway.builder.build(rig.now_ns, 9, 1, 0)
    reckoning.step(rig.now_ns, standing, Motion(40.0), start)
    reckoning.restart(rig.now_ns, Course(10.0, 5.0, 0.1, 40.0, 0.0, 0.03))
    pose = reckoning.step(rig.now_ns + TICK_NS, standing, Motion(40.0, by_gyro=False), None)
    assert pose is not None and pose.yaw == 0.1
    assert (pose.x, pose.y) == pytest.approx((10.0 + 0.4 * math.cos(0.1), 5.0 + 0.4 * math.sin(0.1)))


@pytest.mark.parametrize(("noise", "wrong"), [(0.02, False), (0.06, False), (1.0, True)])
def test_fixes_that_scatter_are_wrong_within_0_8_s(noise, wrong):
    rng, fixes, monitor = np.random.default_rng(3), Fixes(0.02), PositionMonitor(0.02)
    state = Rig().gateway.builder.build(0, 9, 1, 0).model_copy(update={"wheel_speed_fl": SPEED})
    for tick in range(1, 130):
        if tick % 5 == 3:
            spread = noise if tick > 50 else 0.02
            x, y = SPEED * 0.01 * tick, spread * rng.standard_normal()
            fixes.take(x, y, tick * TICK_NS)
        place = {"position_x": fixes.x, "position_y": fixes.y, "position_stamp_ns": fixes.stamp_ns}
        told = state.model_copy(update={"position_seq": fixes.seq, **place})
        reckoned = Reckoned(Pose(fixes.x, 0.0, 0.0, SPEED), fixes.stamp_ns, by_gyro=True)
        monitor.step(tick * TICK_NS, told, Motion(SPEED), reckoned, rolls=True)
    assert monitor.wrong == wrong


def test_one_wild_fix_is_forgiven():
    fixes, monitor = Fixes(0.02), PositionMonitor(0.02)
    state = Rig().gateway.builder.build(0, 9, 1, 0).model_copy(update={"wheel_speed_fl": SPEED})
    for tick in range(1, 200):
        if tick % 5 == 3:
            fixes.take(SPEED * 0.01 * tick, 3.0 if tick == 63 else 0.0, tick * TICK_NS)
        place = {"position_x": fixes.x, "position_y": fixes.y, "position_stamp_ns": fixes.stamp_ns}
        told = state.model_copy(update={"position_seq": fixes.seq, **place})
        reckoned = Reckoned(Pose(fixes.x, 0.0, 0.0, SPEED), fixes.stamp_ns, by_gyro=True)
        monitor.step(tick * TICK_NS, told, Motion(SPEED), reckoned, rolls=True)
    assert not monitor.wrong
