"""From rest, from anywhere on the road: the planner drives off at once, or says why it cannot."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator

import numpy as np
import pytest
from support.cars.model_car import ModelCar, planner_config
from support.promise_figures import record_figure, volume

from hil_gateway.bus.messages import PlanStatus
from hil_gateway.track.loading import load_track
from hil_gateway.track.track import Track

HALF_WIDTH = 1.0
TRACKS = ("road_course", "tri_oval")


@pytest.fixture(scope="module", params=TRACKS)
def rig(request: pytest.FixtureRequest) -> Iterator[ModelCar]:
    yield ModelCar(planner_config(), load_track(request.param))


def put(rig: ModelCar, track: Track, s: float, lateral: float, turned: float) -> None:
    """Set the car down, standing, at an offset to the left of the centre line and an angle to it."""
    at = track.at(s)
    x, y = at.x - lateral * math.sin(at.heading), at.y + lateral * math.cos(at.heading)
    rig.car[:] = x, y, at.heading + turned, 0.0, 0.0, 0.0
    rig.drive = rig.steer = 0.0


def beyond(track: Track, x: float, y: float) -> float:
    """How far the car at a place is beyond the edge of road or pit lane, m; negative on it."""
    return HALF_WIDTH - track.inside(*track.project(x, y))


@pytest.mark.promise("G3")
def test_a_car_anywhere_across_the_road_is_under_way_within_2_s_or_told_why(rig: ModelCar) -> None:
    track, rng = rig.planner._track, np.random.default_rng(39)
    refused, places = 0, volume(12, 200)
    for _ in range(places):
        s = float(rng.uniform(0.0, track.length))
        at = track.at(s)
        lateral, turned = rng.uniform(1.0 - at.width_right, at.width_left - 1.0), rng.uniform(-1.0, 1.0)
        put(rig, track, s, lateral, turned)
        stood, begun = beyond(track, rig.car[0], rig.car[1]), len(rig.cars)
        rig.run(2.0)
        plan = rig.plans[-1]
        if rig.car[3] < 1.0:
            refused += 1
            assert plan.status is PlanStatus.NOT_MOVING
            assert "more road on the" in plan.reason, (s, lateral, turned, plan.reason)
            assert_needs_more_road(track, s, lateral, turned)
            continue
        assert plan.status is PlanStatus.SOLVED
        rig.run(4.0)
        worst = max(beyond(track, car[0], car[1]) for car in rig.cars[begun::10])
        assert worst < max(stood, 0.0) + 0.15, (s, lateral, turned)
    assert refused < places / 4
    record_figure("G3", f"planner alone: {places} places across {track.name}, {refused} told to be turned or pushed")


def assert_needs_more_road(track: Track, s: float, lateral: float, turned: float) -> None:
    """Nine tenths of the steering, which takes 3 m until it is there, turn the car on a circle that leaves the road on
    the side it points to."""
    at, radius = track.at(s), 2.972 / math.tan(0.9 * 0.26)
    room = (at.width_left - lateral if turned > 0 else at.width_right + lateral) - HALF_WIDTH
    assert radius * (1.0 - math.cos(turned)) + 1.5 * math.sin(abs(turned)) > room, (s, lateral, turned, room)


@pytest.mark.promise("G3")
def test_a_car_in_the_pit_lane_drives_along_it_and_onto_the_road(rig: ModelCar) -> None:
    track, rng = rig.planner._track, np.random.default_rng(12)
    lane = track.pit_lane
    assert lane is not None
    places = volume(4, 40)
    for _ in range(places):
        s = float(rng.uniform(lane.s[0], lane.s[-1] - 40.0))
        put(rig, track, s, np.interp(s, lane.s, lane.offset) + rng.uniform(-1.0, 1.0), rng.uniform(-0.2, 0.2))
        begun = len(rig.cars)
        rig.run(2.0)
        assert rig.car[3] > 1.0
        while track.room(*track.project(rig.car[0], rig.car[1])).in_lane:
            rig.run(1.0)
            assert rig.plans[-1].status is PlanStatus.SOLVED
        rig.run(4.0)
        assert rig.car[3] > 10.0
        for car in rig.cars[begun::10]:
            assert beyond(track, car[0], car[1]) < 0.1, s
            at, lateral = track.project(car[0], car[1])
            limited = lane.limit[0] <= lane.along(at, track.length) <= lane.limit[1]
            assert car[3] < lane.speed + 0.5 or not (limited and track.room(at, lateral).in_lane)
    record_figure("G3", f"planner alone: {places} places in the pit lane of {track.name}")


@pytest.mark.promise("G3")
@pytest.mark.parametrize("degrees", [90.0, -90.0, 180.0])
def test_a_car_across_or_against_the_track_is_told_to_be_turned(rig: ModelCar, degrees: float) -> None:
    put(rig, rig.planner._track, 300.0, 0.0, math.radians(degrees))
    rig.run(1.0)
    plan = rig.plans[-1]
    assert plan.status is PlanStatus.NOT_MOVING
    found = re.fullmatch(r"the car points (\d+) degrees across the track: turn it", plan.reason)
    assert found is not None, plan.reason
    assert abs(int(found[1]) - abs(degrees)) < 10.0, "of the race line, which is nearly the track's direction"
    assert rig.car[3] < 0.05, "what was commanded before it was put there"


@pytest.mark.promise("G3")
def test_a_car_towed_anywhere_drives_off_from_there(rig: ModelCar) -> None:
    """Everything runs on: the planner finds the car wherever it is put."""
    track = rig.planner._track
    put(rig, track, 875.0, 0.0, 0.0)
    rig.run(3.0)
    for s in (0.0, 0.4 * track.length, track.length - 20.0, 0.7 * track.length):
        put(rig, track, s, 1.0, 0.1)
        rig.run(2.0)
        assert rig.car[3] > 1.0
        assert rig.plans[-1].status is PlanStatus.SOLVED
        assert abs(math.remainder(rig.plans[-1].s[0] - s, track.length)) < 0.02 * track.length


def test_before_the_line_is_before_the_first_lap() -> None:
    rig = ModelCar(planner_config())
    put(rig, rig.planner._track, rig.planner._track.length - 15.0, 0.0, 0.0)
    rig.run(5.0)
    laps = [(plan.s[0] > 0.0, plan.lap) for plan in rig.plans]
    assert rig.plans[0].s[0] < 0.0 < rig.plans[-1].s[0]
    assert {lap for _, lap in laps} == {0}
