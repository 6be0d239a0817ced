"""Steering and braking without the planner."""

from __future__ import annotations

import math

import numpy as np
import pytest
from support.scripted_car import Rig

from hil_gateway.bus.messages import PlanStatus
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.gateway.act.stopping import Path, Stopping, plan_path
from hil_gateway.gateway.perceive.dead_reckoning import Pose
from hil_gateway.gateway.perceive.motion import Motion
from hil_gateway.gateway.settings import StopConfig
from hil_gateway.track.loading import load_track

VEHICLE = Vehicle()
HERE = Pose(0.0, 0.0, 0.0, 40.0)


@pytest.fixture
def rig() -> Rig:
    made = Rig()
    made.run(0.2)
    return made


def stopping(track=None) -> Stopping:
    return Stopping(VEHICLE, StopConfig(), 50_000.0, track)


def motion(speed: float = 40.0, ay: float = 0.0) -> Motion:
    return Motion(speed=speed, ay=ay)


def test_points_ahead_lie_on_the_path_and_end_with_it():
    path = Path(np.array([0.0, 10.0, 10.0]), np.array([0.0, 0.0, 10.0]), np.array([0.0, 10.0, 20.0]))
    assert path.ahead(0.0, 1.0, 5.0) == (5.0, 0.0)
    assert path.ahead(9.0, 0.0, 5.0) == (10.0, 5.0)
    assert path.ahead(9.0, 9.0, 50.0) == (10.0, 10.0)


def test_a_plan_of_one_point_is_no_path(rig):
    standing = rig.plan(0).model_copy(update={"x": (1.0, 1.0, 1.0), "y": (2.0, 2.0, 2.0)})
    assert plan_path(standing, None) is None
    assert plan_path(standing.model_copy(update={"x": (), "y": ()}), None) is None


def test_beyond_the_plan_the_path_follows_the_track_at_the_same_offset(rig):
    track = load_track("oval")
    s, offset = 100.0, 2.5
    on = [track.at(s + 2.0 * i) for i in range(20)]
    x = tuple(p.x - offset * math.sin(p.heading) for p in on)
    y = tuple(p.y + offset * math.cos(p.heading) for p in on)
    path = plan_path(rig.plan(0).model_copy(update={"x": x, "y": y}), track)
    assert path.s[-1] > 400
    offsets = [track.project(float(px), float(py))[1] for px, py in zip(path.x, path.y, strict=True)]
    assert offsets == pytest.approx([offset] * len(offsets), abs=0.05)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_car_beside_its_path_steers_towards_it(rig, side):
    stop = stopping()
    stop.take_plan(rig.plan(0), stopping=False)
    stop.start(0.0)
    steer, _ = stop.command(motion(), Pose(0.0, side, 0.0, 40.0), emergency=False)
    assert math.copysign(1.0, steer) == -side


def test_pure_pursuit_is_exact_on_a_circle(rig):
    """delta = atan(L / R) for a rear axle on a circle of radius R (Coulter 1992)."""
    radius, angles = 80.0, np.linspace(0.0, 1.5, 1501)
    x, y = radius * np.sin(angles), radius * (1 - np.cos(angles))
    stop = stopping()
    stop.take_plan(rig.plan(0).model_copy(update={"x": tuple(x), "y": tuple(y)}), stopping=False)
    stop.start(0.0)
    steer, _ = stop.command(motion(20.0), Pose(VEHICLE.lr, 0.0, 0.0, 20.0), emergency=False)
    assert steer == pytest.approx(math.atan(VEHICLE.wheelbase / radius), rel=0.01)


def test_without_a_path_the_steering_is_held(rig):
    stop = stopping()
    stop.start(0.07)
    assert stop.command(motion(), HERE, emergency=True)[0] == 0.07


def test_what_the_planner_falls_back_to_is_not_taken_as_a_path(rig):
    stop = stopping()
    stop.take_plan(rig.plan(0).model_copy(update={"status": PlanStatus.STOP}), stopping=False)
    stop.take_plan(rig.plan(0).model_copy(update={"status": PlanStatus.SHIFTED}), stopping=False)
    stop.start(0.07)
    assert stop.command(motion(), HERE, emergency=True)[0] == 0.07


def test_during_a_stop_the_path_stays(rig):
    """Plans made meanwhile begin at the car: following them, it would never come back to where it should be."""
    stop = stopping()
    stop.take_plan(rig.plan(0), stopping=False)
    stop.start(0.0)
    beside = Pose(0.0, 2.0, 0.0, 40.0)
    steer, _ = stop.command(motion(), beside, emergency=False)
    stop.take_plan(rig.plan(0).model_copy(update={"y": tuple(2.0 for _ in rig.plan(0).y)}), stopping=True)
    assert stop.command(motion(), beside, emergency=False)[0] == steer < -0.01


def test_a_plan_that_comes_during_a_stop_is_better_than_none(rig):
    stop = stopping()
    stop.start(0.07)
    stop.take_plan(rig.plan(0), stopping=True)
    assert stop.command(motion(), HERE, emergency=False)[0] != 0.07


@pytest.mark.parametrize(("emergency", "deceleration"), [(False, 6.0), (True, 12.0)])
def test_braking_is_as_configured_on_a_straight(rig, emergency, deceleration):
    _, drive = stopping().command(motion(), HERE, emergency)
    assert drive * 50_000.0 / VEHICLE.mass == pytest.approx(-deceleration)


def test_braking_leaves_the_grip_a_bend_needs(rig):
    _, straight = stopping().command(motion(20.0, ay=0.0), HERE, emergency=True)
    _, bend = stopping().command(motion(20.0, ay=11.0), HERE, emergency=True)
    _, beyond = stopping().command(motion(20.0, ay=40.0), HERE, emergency=True)
    assert straight < bend < beyond < 0
