"""One wheel against three: a wrong sensor is found, a wheel that the brakes lock is not taken for one."""

from __future__ import annotations

import pytest
from support.cars.scripted_car import Rig

from hil_gateway.bus.messages import VehicleState
from hil_gateway.config import Config
from hil_gateway.gateway.perceive.monitors.wheels import WheelMonitor
from hil_gateway.gateway.perceive.motion import Motion

CONFIG = Config()
SPEED = 40.0
WHEEL = "wheel_speed_fl"


def driving(share: float, deceleration: float) -> VehicleState:
    """`share`: the front left wheel's speed over that of the others; `deceleration`: by the brakes, m/s2."""
    rig = Rig()
    rig.run(0.05)
    car, train = CONFIG.vehicle, CONFIG.powertrain
    half_pa = 0.5 * deceleration * car.mass / train.brake_force_per_pa
    wheels = {f"wheel_speed_{wheel}": SPEED for wheel in ("fl", "fr", "rl", "rr")} | {WHEEL: share * SPEED}
    drive = -deceleration * car.mass / train.force_per_drive
    return rig.gateway.seen[0].model_copy(
        update={"drive": drive, "brake_front": half_pa, "brake_rear": half_pa, "yaw_rate": 0.0, **wheels}
    )


def held_s(*states: VehicleState) -> float:
    """Time for which one wheel is found wrong at the end of one second of each of `states`."""
    return held_for(*(state for state in states for _ in range(100)))


def held_for(*states: VehicleState) -> float:
    """The same, 10 ms of each."""
    monitor, held = WheelMonitor(CONFIG), 0.0
    for tick, state in enumerate(states):
        held = monitor.step(tick * 10_000_000, state, Motion(SPEED))
    return held


@pytest.mark.parametrize("share", [0.0, 0.75])
def test_an_inner_wheel_that_the_brakes_lock_is_no_wrong_sensor_for_as_long_as_they_press(share: float) -> None:
    assert held_s(*3 * [driving(share, 14.0)]) == 0.0


@pytest.mark.parametrize("share", [0.0, 0.75])
@pytest.mark.parametrize("deceleration", [0.0, 5.0])
def test_a_slow_wheel_is_a_wrong_sensor_where_the_brakes_press_too_little_to_lock_it(
    share: float, deceleration: float
) -> None:
    assert held_s(driving(share, deceleration)) > 0.25


def test_a_wheel_that_falls_faster_than_brakes_can_stop_one_is_a_wrong_sensor_under_any_braking() -> None:
    sound, falling = driving(1.0, 14.0), [driving(share, 14.0) for share in (0.9, 0.8, 0.7)]
    assert held_for(sound, *30 * [driving(0.7, 14.0)]) > 0.25
    assert held_for(sound, *falling, *27 * [driving(0.7, 14.0)]) == 0.0


def test_a_wheel_that_stays_slow_after_the_brakes_is_found_within_a_second() -> None:
    assert held_s(driving(0.0, 14.0), driving(0.0, 0.0)) > 0.15


def test_a_wheel_that_is_faster_than_all_others_is_a_wrong_sensor_under_any_braking() -> None:
    assert held_s(driving(1.3, 14.0)) > 0.15


@pytest.mark.parametrize(("fallen", "found"), [(0.8, True), (0.9, False)])
def test_wheels_that_all_fall_faster_than_brakes_can_stop_them_are_seen_in_that_period(
    fallen: float, found: bool
) -> None:
    """Of the speed before: a fifth at once is no braking, a tenth may be that of 0.1 s without wheel speeds."""
    monitor, before = WheelMonitor(CONFIG), driving(1.0, 14.0)
    after = before.model_copy(update={f"wheel_speed_{wheel}": fallen * SPEED for wheel in ("fl", "fr", "rl", "rr")})
    seen = []
    for tick, state in enumerate((before, before, after, after)):
        monitor.step(tick * 10_000_000, state, Motion(SPEED))
        seen.append(monitor.all_fell)
    assert seen == [False, False, found, False]
