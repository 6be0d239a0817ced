"""The way through the pit lane: through its box, inside its edges, at its speed, and the race line elsewhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimator.model.parameters import tyre_prior
from estimator.model.single_track import SingleTrack
from hil_gateway.car.car import load_car
from hil_gateway.settings.gateway import CAUTION_DECELERATION
from hil_gateway.track.loading import load_track, shipped_tracks
from hil_gateway.track.track import Box, Track
from planner.line.envelope import envelope_of
from planner.line.pit_route import PitRoutes
from planner.line.raceline import centre_line
from planner.line.track import Reference
from planner.problem.settings import declared_settings

CAR = load_car()
CLEARANCE = 1.25
"""of half the car and what a plan keeps beside it, m"""


def base_of(track: Track) -> Reference:
    model, tyre = SingleTrack(CAR.vehicle, tyre_prior(CAR, "per_axle")), tyre_prior(CAR, "per_axle")
    return Reference(centre_line(track, envelope_of(model, [tyre[p.name] for p in model.tyre_table], car=CAR)))


def routes(track: Track) -> PitRoutes:
    return PitRoutes(track, CAR.vehicle.wheelbase, declared_settings(CAR).limits, CLEARANCE)


@pytest.mark.parametrize("name", sorted(shipped_tracks()))
@pytest.mark.parametrize("number", [None, 0, -1])
def test_the_way_goes_through_the_box_inside_the_edges_at_the_lanes_speed(name: str, number: int | None) -> None:
    track = load_track(name)
    lane, base = track.pit_lane, base_of(track)
    assert lane is not None
    box = None if number is None else lane.boxes[number]
    route = routes(track).through(base, box)
    assert not isinstance(route, str), route
    for s in np.arange(route.begin, route.end, 1.0):
        point = route.reference.at(np.array([s]))
        at, lateral = track.project(float(point.x[0]), float(point.y[0]))
        assert track.inside(at, lateral) > CLEARANCE, s
        if lane.limit[0] <= lane.along(at, track.length) <= lane.limit[1]:
            assert route.reference.speed_limit(np.array([s]))[0] <= lane.speed + 1e-9
    if box is not None:
        x, y, yaw = track.box_pose(box)
        point = route.reference.at(np.array([route.place]))
        assert np.hypot(point.x[0] - x, point.y[0] - y) < 0.05
        assert abs(np.angle(np.exp(1j * (point.heading[0] - yaw)))) < 0.01


def test_elsewhere_it_is_the_race_line_braked_for_gently() -> None:
    track = load_track("oval")
    base = base_of(track)
    route = routes(track).through(base, None)
    assert not isinstance(route, str)
    s = np.arange(route.end - base.length, route.begin, 1.0)
    for name in ("x", "y"):
        np.testing.assert_allclose(getattr(route.reference.at(s), name), getattr(base.at(s), name), atol=1e-3)
    assert [route.holds(at) for at in (route.begin - 1.0, route.place - base.length, route.end + 1.0)] == [0, 1, 0]
    v = route.reference.speed_limit(s)
    assert (np.diff(v**2) / 2.0 > -CAUTION_DECELERATION - 0.2).all()
    assert (v <= base.speed_limit(s) + 1e-9).all()


def test_a_box_too_near_the_lanes_edge_is_refused_in_words() -> None:
    track = load_track("oval")
    lane = track.pit_lane
    assert lane is not None
    narrow = replace(track, pit_lane=replace(lane, boxes=(Box(lane.boxes[0].s, 18.0),)))
    assert narrow.pit_lane is not None
    found = routes(narrow).through(base_of(narrow), narrow.pit_lane.boxes[0])
    assert isinstance(found, str)
    assert "within 1.00 m of an edge, the car needs 1.55 m" in found
