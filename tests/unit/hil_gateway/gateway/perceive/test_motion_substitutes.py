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
from hil_gateway.gateway.perceive.motion import Judged, MotionReader, second_fastest
from hil_gateway.observer.observer import Observer

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


class Silent(Observer):
    """Has not seen the car: what the reader has learnt itself is left."""

    def step(self, *_: object, **__: object) -> None:
        pass


def made() -> MotionReader:
    return MotionReader(load_car(), Observer(CONFIG))


def alone() -> MotionReader:
    return MotionReader(load_car(), Silent(CONFIG))


def run(reader: MotionReader, state: VehicleState, seconds: float, start_ns: int, commanded: ActuatorPositions) -> int:
    for _ in range(round(100 * seconds)):
        start_ns += PERIOD_NS
        reader.step(start_ns, state, None, commanded)
    return start_ns


def test_with_nothing_reported_the_speed_falls_by_what_the_brakes_are_asked_for() -> None:
    reader, rolling, braking = (
        made(),
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


def test_with_nothing_reported_the_car_turns_a_tenth_of_a_second_after_its_command() -> None:
    reader, straight = made(), ActuatorPositions(0.0, 0.1, 0.0, 0.0, 3)
    now_ns = run(reader, driving(30.0, 0.0, sources=True), 1.0, 0, straight)
    turning = straight._replace(steering_motor=CAR.steering_ratio * 0.05)
    now_ns = run(reader, driving(30.0, 0.0, sources=False), 0.09, now_ns, turning)
    assert reader.motion.yaw_rate == 0.0
    run(reader, driving(30.0, 0.0, sources=False), 0.5, now_ns, turning)
    assert reader.motion.yaw_rate > 0.2


@pytest.mark.parametrize("wrong", [True, False])
def test_what_a_wrong_imu_has_taught_at_last_is_not_gone_by(wrong: bool) -> None:
    """A gyro that says 0.3 rad/s too much for half a second makes a car that understeers seem to oversteer."""
    speed, steer = 60.0, 15.0 / 60.0**2 * (CAR.wheelbase + UNDERSTEER * 60.0**2)
    reader, rolling = made(), ActuatorPositions(CAR.steering_ratio * steer, 0.1, 0.0, 0.0, 6)
    bend = driving(speed, steer, sources=True)
    now_ns, before = run(reader, bend, 6.0, 0, rolling), reader.motion.understeer
    now_ns = run(reader, bend.model_copy(update={"yaw_rate": bend.yaw_rate + 0.3}), 0.5, now_ns, rolling)
    reader.judged = Judged(imu_wrong=wrong)
    run(reader, bend, 0.1, now_ns, rolling)
    assert (reader.motion.understeer == pytest.approx(before, rel=0.1)) is wrong


@pytest.mark.parametrize("speed", [25.0, 60.0])
def test_with_nothing_reported_the_car_turns_as_its_understeer_has_been_learnt(speed: float) -> None:
    steer = 15.0 / speed**2 * (CAR.wheelbase + UNDERSTEER * speed**2)
    reader, bend = alone(), ActuatorPositions(CAR.steering_ratio * steer, 0.1, 0.0, 0.0, 3)
    now_ns = run(reader, driving(speed, steer, sources=True), 6.0, 0, bend)
    run(reader, driving(speed, steer, sources=False), 0.5, now_ns, bend)
    assert reader.motion.yaw_rate == pytest.approx(15.0 / speed, rel=0.06)


def test_with_nothing_reported_the_brakes_take_half_of_the_understeer() -> None:
    speed, steer = 60.0, 15.0 / 60.0**2 * (CAR.wheelbase + UNDERSTEER * 60.0**2)
    reader, half_pa = alone(), 0.5 * 6.0 * CAR.mass / PER_PA
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
    reader = alone()
    now_ns = run(reader, braking, 6.0, 0, asked)
    run(reader, driving(speed, steer, sources=False), 0.5, now_ns, asked)
    slower = reader.motion.speed
    expected = slower * math.tan(steer) / (CAR.wheelbase - 0.5 * UNDERSTEER * slower**2)
    assert reader.motion.yaw_rate == pytest.approx(expected, rel=0.06)


@pytest.mark.parametrize("known", [True, False])
def test_without_a_gyro_the_observer_tells_at_once_what_the_course_does_not_know_yet(known: bool) -> None:
    """A car that begins to slide turns faster, with the steering as it was; the course of the fixes is late. Slower
    than the observer begins there is the course alone."""
    speed = 40.0 if known else 9.0
    reader, straight = made(), driving(speed, 0.0, sources=True)
    course, now_ns = Course(0.0, 0.0, 0.0, speed, 0.0, 0.03), 0
    sides = (("fl", -CAR.track_front), ("fr", CAR.track_front), ("rl", -CAR.track_rear), ("rr", CAR.track_rear))
    turning = straight.model_copy(update={f"wheel_speed_{wheel}": speed + 0.5 * 0.3 * track for wheel, track in sides})
    reader.judged = Judged(imu_gone=True, steers=False)
    for state in [straight] * 50 + [turning] * 15:
        now_ns += PERIOD_NS
        reader.step(now_ns, state, course)
    assert reader.motion.late_s == (0.0 if known else math.inf)
    assert reader.motion.yaw_rate == pytest.approx(0.3 * (1.0 - 13 / 38) if known else 0.0, abs=0.05)


@pytest.mark.parametrize("steer", [-0.1, 0.1])
def test_in_a_bend_the_outer_wheels_do_not_make_the_car_faster(steer: float) -> None:
    reader, state = made(), driving(20.0, steer, sources=True)
    run(reader, state, 0.1, 0, ActuatorPositions(0.0, 0.0, 0.0, 0.0, 3))
    assert reader.motion.speed == pytest.approx(20.0, rel=0.004)


@pytest.mark.parametrize(("share", "found"), [(0.8, True), (0.99, False)])
def test_wheels_that_all_lose_a_fifth_of_their_speed_at_once_are_seen(share: float, found: bool) -> None:
    """Although the speed that a stop goes by falls no faster than tyres can make it."""
    reader, state = made(), driving(40.0, 0.0, sources=True)
    now_ns = run(reader, state, 3.0, 0, ActuatorPositions(0.0, 0.1, 0.0, 0.0, 4))
    slower = {f"wheel_speed_{wheel}": share * 40.0 for wheel in ("fl", "fr", "rl", "rr")}
    run(reader, state.model_copy(update=slower), 0.05, now_ns, ActuatorPositions(0.0, 0.1, 0.0, 0.0, 4))
    assert (reader._observer.speed_off > 1.0) is found
    assert reader.motion.speed > 0.9 * 40.0


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


@pytest.mark.parametrize("late_periods", [1, 10])
def test_both_axles_are_those_of_when_the_steering_answers(late_periods: int) -> None:
    """One period of lateness is that of the report: such steering answers at once, and nothing waits."""
    hertz, dead = 1e4, 0.01 * (late_periods - 1)
    car = load_car()
    quick = car.actuators.model_copy(update={"steering_bandwidth": hertz, "steering_delay": dead})
    reader = MotionReader(car.model_copy(update={"actuators": quick}), Observer(CONFIG))
    straight, turning = (ActuatorPositions(CAR.steering_ratio * steer, 0.1, 0.0, 0.0, 3) for steer in (0.0, 0.03))
    now_ns = run(reader, driving(40.0, 0.0, sources=True), 2.0, 0, straight)
    run(reader, driving(40.0, 0.0, sources=True), 0.2, now_ns, turning)
    in_time, late, long_ago = (reader.axles(late_s, mirrored=False) for late_s in (0.0, 0.05, 10.0))
    mirrored = reader.axles(0.0, mirrored=True)
    assert in_time is not None and late is not None and long_ago is not None and mirrored is not None
    assert (in_time.turned == 0.0) is (late_periods == 1)
    assert late.yaw_rate > in_time.yaw_rate + 0.02 * (late_periods > 1)
    assert math.isfinite(long_ago.steered(0.0))
    assert mirrored.turned == pytest.approx(-in_time.turned, abs=2e-3)
