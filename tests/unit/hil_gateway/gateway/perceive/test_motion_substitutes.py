"""What a stop goes by when sensors are gone: their commands, and what they taught before."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from support.cars.scripted_car import Rig

from hil_gateway.bus.messages import VehicleState
from hil_gateway.car.actuation import ActuatorPositions
from hil_gateway.car.car import load_car
from hil_gateway.config import Config
from hil_gateway.gateway.perceive.course import Course
from hil_gateway.gateway.perceive.monitors.sensors import SpeedChangeMonitor
from hil_gateway.gateway.perceive.monitors.wheels import LockedWheels
from hil_gateway.gateway.perceive.motion import WHEELS_SHARE, Judged, MotionReader, second_fastest

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
    health = {name: replace(source, valid=sources) for name, source in state.sources.items()}
    ahead = speed * math.cos(steer) + CAR.wheelbase * turn * math.sin(steer)
    fronts = {
        f"wheel_speed_f{side}": ahead + sign * 0.5 * CAR.track_front * turn for side, sign in (("l", -1), ("r", 1))
    }
    changes = {"steer": steer, "yaw_rate": turn, "ay": speed * turn, "sources": health}
    return state.model_copy(update=changes | fronts | rears)


def run(reader: MotionReader, state: VehicleState, seconds: float, start_ns: int, commanded: ActuatorPositions) -> int:
    for _ in range(round(100 * seconds)):
        start_ns += PERIOD_NS
        reader.step(start_ns, state, None, commanded)
    return start_ns


def test_with_nothing_reported_the_speed_falls_by_what_the_brakes_are_asked_for() -> None:
    reader, rolling, braking = (
        MotionReader(load_car()),
        ActuatorPositions(0.0, 0.1, 0.0, 0.0, 3),
        6.0 * CAR.mass / PER_PA,
    )
    now_ns = run(reader, driving(30.0, 0.0, sources=True), 1.0, 0, rolling)
    run(
        reader,
        driving(30.0, 0.0, sources=False),
        2.0,
        now_ns,
        ActuatorPositions(0.0, 0.0, 0.5 * braking, 0.5 * braking, 3),
    )
    drag = 0.5 * CAR.air_density * CAR.drag_area / CAR.mass
    assert 30.0 - 2.0 * (6.0 + drag * 30.0**2) < reader.motion.speed < 30.0 - 2.0 * 6.0


@pytest.mark.parametrize("speed", [25.0, 60.0])
def test_with_nothing_reported_the_car_turns_as_its_understeer_has_been_learnt(speed: float) -> None:
    steer = 15.0 / speed**2 * (CAR.wheelbase + UNDERSTEER * speed**2)
    reader, bend = MotionReader(load_car()), ActuatorPositions(CAR.steering_ratio * steer, 0.1, 0.0, 0.0, 3)
    now_ns = run(reader, driving(speed, steer, sources=True), 6.0, 0, bend)
    run(reader, driving(speed, steer, sources=False), 0.5, now_ns, bend)
    assert reader.motion.yaw_rate == pytest.approx(15.0 / speed, rel=0.06)


def test_with_nothing_reported_the_car_turns_a_tenth_of_a_second_after_its_command() -> None:
    reader, straight = MotionReader(load_car()), ActuatorPositions(0.0, 0.1, 0.0, 0.0, 3)
    now_ns = run(reader, driving(30.0, 0.0, sources=True), 1.0, 0, straight)
    turning = straight._replace(steering_motor=CAR.steering_ratio * 0.05)
    now_ns = run(reader, driving(30.0, 0.0, sources=False), 0.09, now_ns, turning)
    assert reader.motion.yaw_rate == 0.0
    run(reader, driving(30.0, 0.0, sources=False), 0.5, now_ns, turning)
    assert reader.motion.yaw_rate > 0.2


def test_with_nothing_reported_the_brakes_take_half_of_the_understeer() -> None:
    speed, steer = 60.0, 15.0 / 60.0**2 * (CAR.wheelbase + UNDERSTEER * 60.0**2)
    reader, half_pa = MotionReader(load_car()), 0.5 * 6.0 * CAR.mass / PER_PA
    rolling = ActuatorPositions(CAR.steering_ratio * steer, 0.1, 0.0, 0.0, 6)
    now_ns = run(reader, driving(speed, steer, sources=True), 6.0, 0, rolling)
    braking = rolling._replace(accelerator=0.0, brake_front=half_pa, brake_rear=half_pa)
    run(reader, driving(speed, steer, sources=False), 0.5, now_ns, braking)
    turns = reader.motion.speed * math.tan(steer) / (CAR.wheelbase + 0.5 * UNDERSTEER * reader.motion.speed**2)
    assert reader.motion.yaw_rate == pytest.approx(turns, rel=0.06)


def test_with_nothing_reported_the_car_turns_under_the_brakes_as_it_has_under_them() -> None:
    """A car that oversteers when braking loads its better front tyres."""
    speed, half_pa = 40.0, 0.5 * 8.0 * CAR.mass / PER_PA
    steer = 8.0 / speed**2 * (CAR.wheelbase - 0.5 * UNDERSTEER * speed**2)
    turns = driving(speed, steer, sources=True).model_copy(update={"yaw_rate": 8.0 / speed, "ay": 8.0})
    braking = turns.model_copy(update={"brake_front": half_pa, "brake_rear": half_pa})
    asked = ActuatorPositions(CAR.steering_ratio * steer, 0.0, half_pa, half_pa, 4)
    reader = MotionReader(load_car())
    now_ns = run(reader, braking, 6.0, 0, asked)
    run(reader, driving(speed, steer, sources=False), 0.5, now_ns, asked)
    slower = reader.motion.speed
    expected = slower * math.tan(steer) / (CAR.wheelbase - 0.5 * UNDERSTEER * slower**2)
    assert reader.motion.yaw_rate == pytest.approx(expected, rel=0.06)


@pytest.mark.parametrize("wrong", [True, False])
def test_what_a_wrong_imu_has_taught_at_last_is_not_gone_by(wrong: bool) -> None:
    """A gyro that says 0.3 rad/s too much for half a second makes a car that understeers seem to oversteer."""
    speed, steer = 60.0, 15.0 / 60.0**2 * (CAR.wheelbase + UNDERSTEER * 60.0**2)
    reader, rolling = MotionReader(load_car()), ActuatorPositions(CAR.steering_ratio * steer, 0.1, 0.0, 0.0, 6)
    bend = driving(speed, steer, sources=True)
    now_ns = run(reader, bend, 6.0, 0, rolling)
    now_ns = run(reader, bend.model_copy(update={"yaw_rate": bend.yaw_rate + 0.3}), 0.5, now_ns, rolling)
    reader.judged = Judged(imu=False, imu_wrong=wrong)
    run(reader, bend, 0.1, now_ns, rolling)
    assert (reader.motion.understeer > 0.9 * UNDERSTEER) is wrong


@pytest.mark.parametrize("wheels", [True, False])
def test_without_a_gyro_the_wheels_tell_at_once_half_of_what_the_course_does_not_know_yet(wheels: bool) -> None:
    """A car that begins to slide turns faster, with the steering as it was; the course of the fixes is late."""
    speed = 40.0
    reader, straight = MotionReader(load_car()), driving(speed, 0.0, sources=True)
    course, now_ns = Course(0.0, 0.0, 0.0, speed, 0.0, 0.0, 0.0), 0
    sides = (("fl", -CAR.track_front), ("fr", CAR.track_front), ("rl", -CAR.track_rear), ("rr", CAR.track_rear))
    turning = straight.model_copy(update={f"wheel_speed_{wheel}": speed + 0.5 * 0.3 * track for wheel, track in sides})
    reader.judged = Judged(imu=False, wheels=wheels)
    for state in [straight] * 50 + [turning] * 15:
        now_ns += PERIOD_NS
        reader.step(now_ns, state, course)
    assert reader.motion.prompt is wheels
    assert reader.motion.yaw_rate == pytest.approx(WHEELS_SHARE * 0.3 * (1.0 - 13 / 38) if wheels else 0.0, abs=0.015)


@pytest.mark.parametrize("drive", [0.1, 0.0])
def test_wheels_that_the_engine_drives_are_not_asked_how_the_car_turns(drive: float) -> None:
    """An inner rear wheel that slips under power by 5 % makes the car turn the other way."""
    reader, bend = MotionReader(load_car()), driving(40.0, -0.03, sources=True)
    run(reader, bend, 0.5, 0, ActuatorPositions(0.0, 0.0, 0.0, 0.0, 4))
    slips = bend.model_copy(update={"drive": drive, "wheel_speed_rr": bend.wheel_speed_rr + 2.0 * (drive > 0.0)})
    assert reader.wheel_yaw_rate(slips, 40.0) == pytest.approx(bend.yaw_rate, abs=0.02)


@pytest.mark.parametrize("steer", [-0.1, 0.1])
def test_in_a_bend_the_outer_wheels_do_not_make_the_car_faster(steer: float) -> None:
    reader, state = MotionReader(load_car()), driving(20.0, steer, sources=True)
    run(reader, state, 0.1, 0, ActuatorPositions(0.0, 0.0, 0.0, 0.0, 3))
    assert reader.motion.speed == pytest.approx(20.0, rel=0.004)


@pytest.mark.parametrize(("share", "named"), [(0.8, True), (0.93, False)])
def test_wheels_that_all_lose_a_fifth_of_their_speed_at_once_are_named_within_0_3_s(share: float, named: bool) -> None:
    """Slip of all wheels is no more than 7 % at once."""
    monitor, state, held_s = SpeedChangeMonitor(), driving(40.0, 0.0, sources=True), 0.0
    for tick in range(100):
        speed = 40.0 if tick < 70 else max(40.0 - 0.35 * (tick - 70), 40.0 * share)
        held_s = monitor.step(tick * PERIOD_NS, state.model_copy(update={"ax": 0.0}), speed)
    assert (held_s > 0.0) is named


@pytest.mark.parametrize(("deceleration", "locked"), [(12.0, False), (25.0, True)])
def test_wheels_that_brakes_beyond_the_grip_lock_are_not_taken_for_wrong_sensors(
    deceleration: float, locked: bool
) -> None:
    """Not while they are pressed, nor for half a second after."""
    watch, half_pa = LockedWheels(CONFIG), 0.5 * deceleration * CAR.mass / PER_PA
    braked = driving(40.0, 0.0, sources=True).model_copy(update={"brake_front": half_pa, "brake_rear": half_pa})
    released = braked.model_copy(update={"brake_front": 0.0, "brake_rear": 0.0})
    assert [watch.step(state, 40.0) for state in (braked, *[released] * 49)] == [locked] * 50
    assert not watch.step(released, 40.0)


@pytest.mark.parametrize(
    ("wheels", "drive", "speed"),
    [
        ((27.4, 27.2, 33.1, 33.2), 0.136, 27.4),
        ((27.4, 27.2, 33.1, 33.2), 0.0, 33.1),
        ((0.0, 0.0, 27.5, 27.4), 0.136, 27.4),
        ((27.4, 40.0, 27.9, 27.8), 0.136, 27.9),
    ],
    ids=["both driven wheels spin", "no power that could spin them", "no front wheels", "one front wheel wrong"],
)
def test_driven_wheels_that_spin_under_power_are_not_the_speed_of_the_car(
    wheels: tuple[float, float, float, float], drive: float, speed: float
) -> None:
    rig = Rig()
    rig.run(0.05)
    names = ("wheel_speed_fl", "wheel_speed_fr", "wheel_speed_rl", "wheel_speed_rr")
    state = rig.gateway.seen[0].model_copy(update={"drive": drive, **dict(zip(names, wheels, strict=True))})
    assert second_fastest(state) == speed
