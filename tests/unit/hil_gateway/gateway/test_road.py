"""Off the road, and the pit lane beside it."""

from __future__ import annotations

import math

import pytest

from hil_gateway.gateway.perceive.dead_reckoning import Pose
from hil_gateway.gateway.perceive.monitors.road import PIT_M, PIT_SPEED, RoadMonitor
from hil_gateway.track.loading import load_track

TRACK = load_track("oval")
EDGE = float(TRACK.width_left[100])


def off_s(monitor: RoadMonitor, tick: int, lateral: float, speed: float) -> float:
    p = TRACK.at(100.0)
    x, y = p.x - lateral * math.sin(p.heading), p.y + lateral * math.cos(p.heading)
    return monitor.step(tick * 10_000_000, Pose(x, y, p.heading, speed))[0]


def drive(*places: tuple[float, float]) -> float:
    """Seconds off the road at the last of (lateral, speed), each held for 0.1 s."""
    monitor, off = RoadMonitor(TRACK), 0.0
    for i, (lateral, speed) in enumerate(places):
        for tick in range(10):
            off = off_s(monitor, 10 * i + tick, lateral, speed)
    return off


def test_a_car_that_stands_in_the_pit_lane_drives_to_the_road_at_its_speed():
    assert drive((EDGE + 10.0, 0.0)) == 0.0
    assert drive((EDGE + 10.0, 0.0), (EDGE + 5.0, PIT_SPEED - 1.0), (0.0, PIT_SPEED + 20.0)) == 0.0


@pytest.mark.parametrize(
    "places",
    [
        ((EDGE + PIT_M + 2.0, 0.0),),
        ((EDGE + 10.0, 0.0), (EDGE + 10.0, PIT_SPEED + 1.0)),
        ((EDGE + 10.0, 0.0), (0.0, 15.0), (EDGE + 1.0, 15.0)),
        ((0.0, 40.0), (EDGE + 1.0, 40.0)),
    ],
)
def test_far_from_the_road_too_fast_or_from_the_road_it_is_off(places):
    assert drive(*places) > 0.05
