"""Off the road and its pit lane, and across them."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from hil_gateway.car.car import load_car
from hil_gateway.gateway.act.stop_path import way_along
from hil_gateway.gateway.perceive.dead_reckoning import Pose
from hil_gateway.gateway.perceive.monitors.road import RoadMonitor
from hil_gateway.track.loading import load_track, shipped_tracks
from hil_gateway.track.track import Track

HALF_WIDTH = load_car().vehicle.half_width
TRACK = load_track("oval")
LANE_FROM, LANE_TO = 11.0, 19.0
"""m to the left of the line on the start straight: data/tracks/oval.toml"""


def pose_at(track: Track, s: float, lateral: float, turned: float = 0.0, speed: float = 0.0) -> Pose:
    p = track.at(s)
    x, y = p.x - lateral * math.sin(p.heading), p.y + lateral * math.cos(p.heading)
    return Pose(x, y, p.heading + turned, speed)


def held(lateral: float, turned: float = 0.0, track: Track = TRACK) -> tuple[float, float]:
    """Seconds off the road and the wrong way, of 0.1 s in one place."""
    monitor = RoadMonitor(track, HALF_WIDTH)
    for tick in range(11):
        found = monitor.step(tick * 10_000_000, pose_at(track, 100.0, lateral, turned))
    return found


@pytest.mark.parametrize("lateral", [0.0, 6.0, -7.4, LANE_FROM + 0.5, 15.0, LANE_TO - 0.5])
def test_a_car_on_the_road_or_in_the_pit_lane_is_on_the_track(lateral: float) -> None:
    assert held(lateral)[0] == 0.0


@pytest.mark.parametrize("lateral", [9.3, LANE_TO + 0.5, 30.0, -8.5, -15.0])
def test_a_car_between_them_or_beyond_is_off_the_road(lateral: float) -> None:
    assert held(lateral)[0] == pytest.approx(0.1)


def test_where_no_pit_lane_is_mapped_a_car_beside_the_road_is_off_it() -> None:
    assert held(15.0, track=replace(TRACK, pit_lane=None))[0] == pytest.approx(0.1)


@pytest.mark.parametrize(("degrees", "wrong"), [(0, 0), (55, 0), (-55, 0), (65, 1), (-92, 1), (180, 1)])
def test_a_car_that_points_across_the_track_goes_the_wrong_way(degrees: float, wrong: bool) -> None:
    assert (held(0.0, math.radians(degrees))[1] > 0.0) == wrong


@pytest.mark.parametrize("name", sorted(shipped_tracks()))
def test_a_stop_in_the_pit_lane_stays_in_it(name: str) -> None:
    track = load_track(name)
    lane = track.pit_lane
    assert lane is not None
    for i in range(0, len(lane.s), 20):
        s, offset = float(lane.s[i] % track.length), float(lane.offset[i])
        if not track.room(s, offset).in_lane:
            continue
        way = way_along(track, HALF_WIDTH, pose_at(track, s, offset, speed=18.0), 0.0, 6.0)
        assert way is not None
        stop_m = 18.0**2 / 12.0
        for x, y in zip(way.x[way.s < stop_m], way.y[way.s < stop_m], strict=True):
            assert track.inside(*track.project(x, y)) > 1.5
