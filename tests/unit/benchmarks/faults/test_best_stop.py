"""The judge of stops: it calls impossible only what no brakes and no steering can do."""

from __future__ import annotations

import pytest

from benchmarks.faults.best_stop import best_stop
from hil_gateway.can_link import VirtualWire
from hil_gateway.config import Config
from hil_gateway.plant.car import Commands
from hil_gateway.plant.plant import Plant
from hil_gateway.process.clock import VirtualClock
from hil_gateway.track.loading import load_track


@pytest.fixture
def plant() -> Plant:
    config, track = Config(), load_track("road_course")
    return Plant(config, VirtualWire(VirtualClock(0)).link(), track=track)


def before_a_bend(plant: Plant, speed: float, distance_m: float) -> Plant:
    """Before the first bend of the road course that is tighter than 50 m."""
    track = plant.car.road.track
    bend = next(s for s, k in zip(track.s, track.curvature, strict=True) if abs(k) > 0.02)
    plant.car.place(float(bend) - distance_m, speed)
    return plant


def without_brakes(asked: Commands, before: Commands) -> Commands:
    return asked._replace(brake_front=0.0, brake_rear=0.0)


def test_a_sound_car_before_a_bend_can_be_stopped_on_the_road(plant: Plant) -> None:
    assert best_stop(before_a_bend(plant, 45.0, 60.0), Config(), None).margin_m >= 0.0


def test_a_car_without_brakes_too_fast_for_the_bend_has_no_stop_on_the_road(plant: Plant) -> None:
    assert best_stop(before_a_bend(plant, 65.0, 25.0), Config(), without_brakes).margin_m < 0.0
