"""Nothing on the wire, and no command, can break the simulated car: no exception, no state that is not finite."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from can_dbc.codec import load_codec
from hil_gateway.can_link import VirtualWire
from hil_gateway.config import load_config
from hil_gateway.plant.car import Car, Commands
from hil_gateway.plant.physics.dynamics import STATES
from hil_gateway.plant.physics.parameters import AV24, PAPER, PlantParameters
from hil_gateway.plant.plant import Plant
from hil_gateway.process.clock import VirtualClock
from hil_gateway.track.loading import load_track

IDS = sorted(load_codec().by_id)
FRAMES = st.lists(st.tuples(st.one_of(st.sampled_from(IDS), st.integers(0, 2047)), st.binary(max_size=8)), max_size=60)
COMMANDS = st.builds(
    Commands,
    steer=st.floats(-0.5, 0.5),
    throttle=st.floats(0.0, 1.0),
    brake_front=st.floats(0.0, 8e6),
    brake_rear=st.floats(0.0, 8e6),
    gear=st.integers(0, 6),
)


@pytest.fixture(scope="module")
def bench() -> tuple[VirtualClock, VirtualWire, Plant]:
    clock = VirtualClock(10**9)
    wire = VirtualWire(clock)
    return clock, wire, Plant(load_config(None, {"track": "oval"}), wire.link())


@settings(max_examples=200, deadline=None)
@given(frames=FRAMES)
def test_any_frames_leave_the_car_whole(
    bench: tuple[VirtualClock, VirtualWire, Plant], frames: list[tuple[int, bytes]]
) -> None:
    clock, wire, plant = bench
    link = wire.link()
    for frame_id, data in frames:
        link.send(frame_id, data)
    clock.advance(10_000_000)
    plant.step(clock.now_ns())
    wire.remove(link)
    assert all(np.isfinite(plant.car[name]) for name in STATES)


@pytest.mark.parametrize("parameters", [AV24, PAPER], ids=["av24", "paper"])
@settings(max_examples=25, deadline=None)
@given(speed=st.floats(0.0, 85.0), sequence=st.lists(COMMANDS, min_size=3, max_size=8))
def test_any_commands_leave_the_car_whole(parameters: PlantParameters, speed: float, sequence: list[Commands]) -> None:
    car = Car(parameters, load_track("oval"), speed=speed)
    for commands in sequence:
        for _ in range(250):
            car.step(commands, engine_running=True)
    assert all(np.isfinite(car[name]) for name in STATES)
    assert np.hypot(car["vx"], car["vy"]) < 120.0
    assert abs(car["yaw_rate"]) < 30.0
