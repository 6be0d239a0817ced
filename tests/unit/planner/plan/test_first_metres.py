"""Blind first metres ask for as much room as what is not known of place and heading may need."""

from __future__ import annotations

import math

import pytest

from hil_gateway.bus.messages import Estimate
from hil_gateway.track.loading import load_track
from planner.plan.first_metres import WayLeft

TRACK, S = load_track("oval"), 300.0
HALF_WIDTH = 0.95


def way(to_the_left: float, turned: float, yaw_std: float, place_std: float = 0.0) -> WayLeft:
    """Of a car so many m from the left edge, turned by so much (rad) to the left of the road."""
    at = TRACK.at(S)
    lateral = float(at.width_left) - to_the_left
    x, y = at.x - lateral * math.sin(at.heading), at.y + lateral * math.cos(at.heading)
    std = (place_std, place_std, yaw_std, *(0.0,) * 6)
    estimate = Estimate(
        stamp_ns=1, seq=0, state_stamp_ns=1, valid=False, lacks="heading", x=float(x), y=float(y),
        yaw=float(at.heading) + turned, vx=0.0, vy=0.0, yaw_rate=0.0, std=std,
        **dict.fromkeys(("bias_ax", "bias_ay", "bias_yaw_rate", "steer", "drive"), 0.0), innovations_rejected=0,
    )  # fmt: skip
    return WayLeft.of(estimate, TRACK, HALF_WIDTH, 2.0)


def test_a_car_that_may_point_anywhere_has_its_way_to_the_nearer_edge() -> None:
    left = way(2.0, 0.0, math.pi)
    assert left.metres == pytest.approx(2.0 - HALF_WIDTH, abs=0.01)
    assert left.side == "left"
    assert "left edge" in left.reason
    assert way(2.0, 0.0, math.pi, place_std=0.2).metres == pytest.approx(left.metres - 0.4, abs=0.01)


def test_what_the_first_metres_show_of_the_heading_opens_the_way() -> None:
    blind, shown = way(2.0, 0.0, math.pi), way(2.0, 0.0, 0.1)
    assert shown.metres == pytest.approx(blind.metres / math.sin(0.2), rel=0.02)
    assert way(2.0, -0.5, 0.1).side == "right", "turned away from the nearer edge, the other one is ahead"


def test_a_car_that_points_at_an_edge_has_the_way_there() -> None:
    assert way(2.0, math.radians(50.0), 0.0).metres == pytest.approx(
        (2.0 - HALF_WIDTH) / math.sin(math.radians(50.0)), rel=0.02
    )
    assert way(0.9, 0.0, math.pi).metres < 0.0, "a wheel on the edge: no way at all"
