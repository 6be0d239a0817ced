"""What a stop goes by when sensors are gone: their commands, and what they taught before."""

from __future__ import annotations

import math

import pytest
from support.scripted_car import Rig

from hil_gateway.bus.messages import VehicleState
from hil_gateway.car.actuation import Actuators
from hil_gateway.config import Config
from hil_gateway.gateway.perceive.monitors.sensors import SpeedChangeMonitor
from hil_gateway.gateway.perceive.motion import MotionReader

PERIOD_NS = 10_000_000
CONFIG = Config()
CAR = CONFIG.vehicle
PER_PA = CONFIG.powertrain.brake_force_per_pa
UNDERSTEER = 6e-4
"""rad per m/s2 of the car in these tests"""


def driving(speed: float, steer: float, sources: bool) -> VehicleState:
    """In a steady bend, with every source valid or none."""
    rig = Rig()
    rig.run(0.05)
    state = rig.gateway.seen[0]
    turn = speed * math.tan(steer) / (CAR.wheelbase + UNDERSTEER * speed**2)
    rears = {f"wheel_speed_r{side}": speed + sign * 0.5 * CAR.track_rear * turn for side, sign in (("l", -1), ("r", 1))}
    health = {name: source.model_copy(update={"valid": sources}) for name, source in state.sources.items()}
    fronts = {"wheel_speed_fl": speed, "wheel_speed_fr": speed}
    changes = {"steer": steer, "yaw_rate": turn, "ay": speed * turn, "sources": health}
    return state.model_copy(update=changes | fronts | rears)


def run(reader: MotionReader, state: VehicleState, seconds: float, start_ns: int, commanded: Actuators) -> int:
    for _ in range(round(100 * seconds)):
        start_ns += PERIOD_NS
        reader.step(start_ns, state, None, commanded)
    return start_ns


def test_with_nothing_reported_the_speed_falls_by_what_the_brakes_are_asked_for() -> None:
    reader, rolling, braking = MotionReader(CAR, PER_PA), Actuators(0.0, 0.1, 0.0, 0.0, 3), 6.0 * CAR.mass / PER_PA
    now_ns = run(reader, driving(30.0, 0.0, sources=True), 1.0, 0, rolling)
    run(reader, driving(30.0, 0.0, sources=False), 2.0, now_ns, Actuators(0.0, 0.0, 0.5 * braking, 0.5 * braking, 3))
    drag = 0.5 * CAR.air_density * CAR.drag_area / CAR.mass
    assert 30.0 - 2.0 * (6.0 + drag * 30.0**2) < reader.motion.speed < 30.0 - 2.0 * 6.0


@pytest.mark.parametrize("speed", [25.0, 60.0])
def test_with_nothing_reported_the_car_turns_as_its_understeer_has_been_learnt(speed: float) -> None:
    steer = 15.0 / speed**2 * (CAR.wheelbase + UNDERSTEER * speed**2)
    reader, bend = MotionReader(CAR, PER_PA), Actuators(CAR.steering_ratio * steer, 0.1, 0.0, 0.0, 3)
    now_ns = run(reader, driving(speed, steer, sources=True), 6.0, 0, bend)
    run(reader, driving(speed, steer, sources=False), 0.5, now_ns, bend)
    assert reader.motion.yaw_rate == pytest.approx(15.0 / speed, rel=0.06)


@pytest.mark.parametrize(("share", "named"), [(0.8, True), (0.93, False)])
def test_wheels_that_all_lose_a_fifth_of_their_speed_at_once_are_named_within_0_3_s(share: float, named: bool) -> None:
    """Slip of all wheels is no more than 7 % at once."""
    monitor, state, held_s = SpeedChangeMonitor(), driving(40.0, 0.0, sources=True), 0.0
    for tick in range(100):
        speed = 40.0 if tick < 70 else max(40.0 - 0.35 * (tick - 70), 40.0 * share)
        held_s = monitor.step(tick * PERIOD_NS, state.model_copy(update={"ax": 0.0}), speed)
    assert (held_s > 0.0) is named
