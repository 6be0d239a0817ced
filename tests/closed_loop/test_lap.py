"""The whole loop in one process: laps without leaving the road, the same every time, and what ends them."""

from __future__ import annotations

from typing import Any

import pytest

from hil_gateway.bus import topics
from hil_gateway.bus.messages import Estimate, VehicleState
from hil_gateway.config import load_config
from planner.simulation.loop import Loop, LoopResult
from planner.simulation.loop_log import LOGGED, drive_log


def _loop(track: str = "road_course", **overrides: Any) -> Loop:
    return Loop(load_config(None, {"track": track, **overrides}), keep=LOGGED)


@pytest.mark.slow
@pytest.mark.parametrize(("track", "peak"), [pytest.param("road_course", 50.0, marks=pytest.mark.long), ("oval", 60.0)])
def test_lap_stays_on_the_road_without_a_failed_plan(track: str, peak: float) -> None:
    loop = _loop(track)
    loop.run(seconds=11.0)  # the first metres, at walking pace, take three
    assert_estimate_is_true(loop)
    result = loop.run(laps=1, time_limit_s=160.0)
    assert result.laps == 1
    assert result.off_track == 0
    assert result.worst_margin_m > 0.0
    assert result.failsafes == []
    assert result.plan_failures == 0
    assert result.frames_lost == 0
    assert result.peak_speed > peak


def _seconds(seed: int) -> LoopResult:
    return _loop("oval", **{"plant.seed": seed}).run(seconds=1.0)


def test_one_seed_gives_one_drive() -> None:
    first, again, other = _seconds(5), _seconds(5), _seconds(6)
    key = topics.ESTIMATE.key
    assert first.messages[key] == again.messages[key]
    assert first.messages[key] != other.messages[key]


def assert_estimate_is_true(loop: Loop) -> None:
    """By the plant's state now, and so is the drive log made of what was published."""
    estimate = loop.result.messages[topics.ESTIMATE.key][-1]
    state = loop.result.messages[topics.VEHICLE_STATE.key][-1]
    assert isinstance(estimate, Estimate)
    assert isinstance(state, VehicleState)
    car = loop.plant.car
    assert car["vx"] > 20.0
    assert estimate.x == pytest.approx(car["x"], abs=0.2)
    assert estimate.y == pytest.approx(car["y"], abs=0.2)
    assert estimate.yaw == pytest.approx(car["yaw"], abs=0.01)
    assert estimate.vx == pytest.approx(car["vx"], abs=0.3)
    assert state.steer == pytest.approx(car["steer"], abs=0.003)
    log = drive_log(loop.result)
    assert log.segments() == [slice(0, len(log))]
    assert log["vx"][-1] == estimate.vx
    assert log["ax"].std() > 0.1
