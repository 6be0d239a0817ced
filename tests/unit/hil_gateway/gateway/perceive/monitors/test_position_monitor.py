"""Late fixes are forgiven; fixes where the car cannot be are not."""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Callable

import numpy as np
import pytest
from support.cars.scripted_car import Rig

from hil_gateway.bus.latest import Latest
from hil_gateway.bus.messages import Estimate
from hil_gateway.gateway.perceive.dead_reckoning import DeadReckoning, Pose, Reckoned
from hil_gateway.gateway.perceive.monitors.position import PositionMonitor
from hil_gateway.gateway.perceive.motion import Motion

PERIOD_S, FIX_S = 0.01, 0.05
WHEELS = tuple(f"wheel_speed_{wheel}" for wheel in ("fl", "fr", "rl", "rr"))
SECONDS = 10.0
Place = Callable[[float, float], float]
"""m along a straight that the receiver says, of the time (s) and the place (m)"""


def judged(
    speed: float, decelerating: float, says: Place, late_s: float = 0.0, heading: bool = True,
    *, rolling: float = 1.0, stopping: bool = False, slip: float = 0.0, goes: Callable[[float], float] | None = None,
    read_s: Callable[[float], float] = lambda t: 0.0,
) -> PositionMonitor:  # fmt: skip
    """A car on a straight whose wheels go with `rolling` of its speed, with its nose off by its side `slip` (rad), a
    fix every 50 ms, of which every thirteenth is late; where its heading is not known it is reckoned to go back. It
    `goes` otherwise as fast as that says of the time, and what has come is `read_s` old when it is read."""
    rig = Rig()
    rig.run(0.05)
    state, noise = rig.gateway.seen[0], np.random.default_rng(5)
    reckoning = DeadReckoning(0.02)
    reckoning.now = Reckoned(Pose(0.0, 0.0, math.pi, speed), 0, by_gyro=True, slips=4.0)
    monitor, x, seq, coming = PositionMonitor(0.02), 0.0, state.position_seq, deque[tuple[float, float]]()
    for tick in range(round(SECONDS / PERIOD_S)):
        t = tick * PERIOD_S
        now = max(speed - decelerating * t, min(speed, 12.0)) if goes is None else goes(t)
        x += now * PERIOD_S
        if tick % round(FIX_S / PERIOD_S) == 0:
            late = round(t / FIX_S) % 13 == 7
            coming.append((t + late * late_s, says(t, x) + noise.normal(0.0, 0.02)))
        while coming and coming[0][0] <= t:
            seq += 1
            came_ns, place = round(t * 1e9), coming.popleft()[1]
            position = {"position_x": place, "position_y": noise.normal(0.0, 0.02), "position_stamp_ns": came_ns}
            state = state.model_copy(update={"position_seq": seq, **position})
        wheels, pose = rolling * now, Pose(x + read_s(t) * now, 0.0, -slip, now, slip)
        now_ns, motion = round((t + read_s(t)) * 1e9), Motion(speed=wheels)
        blind = reckoning.carry_on(now_ns, motion)
        reckoned = Reckoned(pose, now_ns, by_gyro=True) if heading else blind
        state = state.model_copy(update=dict.fromkeys(WHEELS, wheels))
        monitor.step(now_ns, state, motion, reckoned, rolls=not stopping)
        reckoning.step(now_ns, state, motion, None, not monitor.suspect)
    return monitor


@pytest.mark.parametrize("speed", [30.0, 60.0, 80.0])
@pytest.mark.parametrize("decelerating", [0.0, 15.0])
@pytest.mark.parametrize("late_s", [0.02, 0.03, 0.04, 0.08])
def test_single_late_fixes_stop_no_car(speed: float, decelerating: float, late_s: float) -> None:
    assert not judged(speed, decelerating, lambda t, x: x, late_s).wrong


@pytest.mark.parametrize("speed", [30.0, 60.0, 80.0])
@pytest.mark.parametrize("read_s", [lambda t: 0.0095, lambda t: 0.0095 * (t > 5.0), lambda t: 0.0095 * (t < 5.0)])
def test_fixes_may_have_come_at_any_time_since_the_period_before(
    speed: float, read_s: Callable[[float], float]
) -> None:
    assert not judged(speed, 0.0, lambda t, x: x, rolling=1.03, read_s=read_s).wrong


@pytest.mark.parametrize("slip", [-0.16, 0.16])
def test_a_car_that_slides_is_where_it_goes_and_not_where_it_points(slip: float) -> None:
    assert not judged(60.0, 0.0, lambda t, x: x, slip=slip).wrong


@pytest.mark.parametrize("speed", [30.0, 60.0, 80.0])
@pytest.mark.parametrize(
    "says",
    [
        pytest.param(lambda t, x: x + 4.0 * (t > 5.0), id="leads by 4 m"),
        pytest.param(lambda t, x: x - 4.0 * (t > 5.0), id="falls back by 4 m"),
        pytest.param(lambda t, x: min(x, 100.0), id="repeats its last"),
        pytest.param(lambda t, x: x - 0.2 * x * (t > 5.0), id="falls behind by a fifth"),
    ],
)
def test_fixes_where_the_car_cannot_be_are_wrong(speed: float, says: Place) -> None:
    monitor = judged(speed, 0.0, says)
    assert monitor.wrong
    assert monitor.source == "they leave the way by wheels and gyro"


@pytest.mark.parametrize(("wild_s", "believed"), [(9.90, True), (9.95, False)])
def test_a_wild_fix_is_not_believed_and_the_next_one_is(wild_s: float, believed: bool) -> None:
    monitor = judged(60.0, 0.0, lambda t, x: x + 4.0 * (abs(t - wild_s) < 0.02))
    assert (monitor.fits, monitor.suspect) == (believed, not believed)


def test_scatter_within_the_bound_of_a_single_fix_adds_up() -> None:
    """By 0.6 m, of 0.9 that one may be off at 60 m/s."""
    sides = itertools.cycle([0.6, -0.6])
    assert judged(60.0, 0.0, lambda t, x: x + next(sides) * (t > 5.0)).wrong


@pytest.mark.parametrize("speed", [0.1, 0.3, 0.6, 1.4, 4.0])
@pytest.mark.parametrize("heading", [True, False])
def test_a_slow_car_is_where_it_can_have_gone(speed: float, heading: bool) -> None:
    assert not judged(speed, 0.0, lambda t, x: x, 0.04, heading).wrong
    assert judged(speed, 0.0, lambda t, x: x + 4.0 * (t > 5.0), 0.0, heading).source


def test_a_car_that_rolls_out_is_not_judged_by_where_it_set_off() -> None:
    """Its wheels show a twentieth less than it goes."""
    monitor = judged(0.0, 0.0, lambda t, x: x, rolling=0.95, goes=lambda t: max(5.0 - abs(t - 4.0) * 1.3, 0.1))
    assert not monitor.source
    assert not monitor.suspect


def test_wheels_that_show_a_little_while_the_car_stands_contradict_no_fix() -> None:
    assert not judged(0.002, 0.0, lambda t, x: x, rolling=140.0).source


def test_fixes_that_stepped_are_believed_again_when_they_fit_a_car_that_stands() -> None:
    """Its wheels show a little more than nothing, as they do."""
    monitor = judged(4.0, 0.0, lambda t, x: x + 4.0 * (t > 5.0))
    assert monitor.wrong
    stands = Rig().gateway.builder.build(0, 9, 1, 0).model_copy(update=dict.fromkeys(WHEELS, 0.1))
    monitor.step(round(SECONDS * 1e9), stands, Motion(speed=0.1), None, rolls=True)
    assert not monitor.wrong


def test_wheels_that_lock_in_a_stop_are_no_witness_against_the_fixes() -> None:
    slides = 20.0
    assert judged(slides, 0.0, lambda t, x: x, heading=False, rolling=0.2).source
    assert not judged(slides, 0.0, lambda t, x: x, heading=False, rolling=0.2, stopping=True).source


def test_fixes_of_a_car_that_stands_may_move() -> None:
    assert not judged(0.0, 0.0, lambda t, x: 4.0 * (t > 5.0)).source


def test_fixes_that_both_other_receivers_leave_are_wrong() -> None:
    monitor = judged(40.0, 0.0, lambda t, x: x)
    monitor.outvoted(1.0)
    assert monitor.wrong
    assert monitor.source == "both other receivers have moved away from them"


@pytest.mark.parametrize("sensors_believed", [True, False])
def test_fixes_that_the_estimator_refuses_are_not_believed(sensors_believed: bool) -> None:
    """It has been valid, still answers, and no longer calls itself so."""
    monitor, rig, newest = judged(40.0, 0.0, lambda t, x: x), Rig(), Latest[Estimate](0.05)
    rig.run(0.05)
    for tick in range(40):
        now_ns = round((SECONDS + tick * PERIOD_S) * 1e9)
        newest.put(rig.estimate(0).model_copy(update={"valid": tick < 30}), now_ns)
        monitor.heed(now_ns, rig.gateway.seen[0], newest, believed=sensors_believed)
        assert monitor.suspect is (sensors_believed and tick >= 30)
