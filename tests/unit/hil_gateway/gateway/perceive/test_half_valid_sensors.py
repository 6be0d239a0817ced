"""Sensors that go on sending and say nothing true: the car is not driven, armed or let go on their word."""

from __future__ import annotations

import random

import pytest
from support.cars.scripted_car import Rig

from hil_gateway.bus import topics
from hil_gateway.bus.messages import FailsafeAction, OperatorAction
from hil_gateway.gateway.perceive.dead_reckoning import Pose

WHEELS = ("wheel_speed_FL", "wheel_speed_FR", "wheel_speed_RL", "wheel_speed_RR")


def moving(speed: float = 30.0) -> Rig:
    """Driving at `speed`, m/s, with wheels and position fixes that say so."""
    rig = Rig()
    rig.drive_off(3.0)
    rig.car.speed = speed
    rig.run(1.0)
    assert rig.action is FailsafeAction.DRIVE
    return rig


def pose(rig: Rig) -> Pose:
    """Where the gateway reckons the car."""
    found = rig.gateway._dead_reckoning.pose
    assert found is not None
    return found


def test_wheel_speeds_that_hang_stop_the_car() -> None:
    rig = moving()
    rig.car.overrides |= dict.fromkeys(WHEELS, 108.0)
    rig.run(0.6)
    assert (rig.action, rig.cause) == (FailsafeAction.CONTROLLED_STOP, "state_invalid")


def test_an_imu_that_others_contradict_says_nothing_of_the_brakes() -> None:
    """It turns as no car does and speeds up while this one brakes: it is wrong, the brakes are not."""
    rig, causes, rng = moving(50.0), set(), random.Random(1)
    wrong = {"imu_yaw_rate": -25.0, "imu_ay": -1.3, "imu_ax": 0.8}
    for tick in range(250):
        drifts = min(tick / 50.0, 1.0)
        rig.car.overrides |= {name: drifts * value + 0.02 * rng.random() for name, value in wrong.items()}
        rig.run(0.01)
        causes.add(rig.cause)
    assert causes == {"", "yaw_rate_wrong"}
    assert rig.action is FailsafeAction.CONTROLLED_STOP


@pytest.mark.parametrize("reading", [0.0, 1.0])
def test_dead_wheel_sensors_do_not_make_a_moving_car_stand(reading: float) -> None:
    """Nor do four locked wheels: it is stopped, and neither let go by a person's disarming nor armed."""
    rig = moving()
    rig.car.overrides |= dict.fromkeys(WHEELS, reading)
    rig.run(0.7)
    assert rig.action is FailsafeAction.CONTROLLED_STOP
    assert rig.cause in ("state_invalid", "position_wrong"), (
        "wheels at rest and fixes that move on contradict each other"
    )
    rig.ask(OperatorAction.DISARM)
    rig.run(0.1)
    assert rig.action is FailsafeAction.CONTROLLED_STOP
    rig.ask(OperatorAction.ARM)
    rig.run(0.1)
    assert rig.action is FailsafeAction.CONTROLLED_STOP


@pytest.mark.parametrize("offsets", [(0.0, 5e-4), (0.0, 2e-6), (0.0, 1e-3, 2e-3)])
def test_a_receiver_that_jumps_or_is_noisy_does_not_disturb_a_standing_car(offsets: tuple[float, ...]) -> None:
    rig = Rig()
    rig.drive = 0.0
    rig.drive_off(0.1)
    rig.hooks.append(
        lambda rig: rig.car.overrides.update(novatel_lat=36.5844 + offsets[(rig.tick // 50) % len(offsets)])
    )
    rig.run(5.0)
    assert rig.action is FailsafeAction.DRIVE


def test_a_car_that_a_bank_presses_beyond_the_range_of_its_imu_keeps_its_gyro() -> None:
    rig = moving()
    rig.hooks.append(lambda rig: rig.car.overrides.update(imu_az=4.1 + 0.01 * (rig.tick % 7)))
    rig.run(1.0)
    assert rig.action is FailsafeAction.DRIVE


def test_a_car_at_constant_speed_is_driven() -> None:
    """Wheels are never the same to the last bit, as those of a real car."""
    rig = moving()
    rig.hooks.append(lambda rig: rig.car.overrides.update(wheel_speed_FL=3.6 * rig.car.speed + 0.01 * (rig.tick % 7)))
    rig.run(5.0)
    assert rig.action is FailsafeAction.DRIVE


IMU = {"imu_1", "imu_2", "imu_3"}


def test_an_imu_that_was_gone_and_comes_back_is_not_used_again_until_the_car_stands() -> None:
    """What comes back may be late."""
    rig = moving()
    rig.car.muted |= IMU
    rig.run(0.3)
    assert rig.cause == "state_invalid"
    rig.car.muted -= IMU
    rig.run(0.3)
    assert not rig.gateway.monitors.motion.motion.by_gyro
    assert not rig.gateway.monitors.estimate_fits
    rig.car.speed = 0.0
    rig.run(0.3)
    rig.ask(OperatorAction.DISARM)
    rig.run(0.1)
    assert rig.action is FailsafeAction.SILENT
    assert rig.gateway.monitors.motion.motion.by_gyro


def test_an_imu_that_was_gone_with_everything_else_is_used_again() -> None:
    rig = moving()
    rig.car.reports = False
    rig.run(0.3)
    rig.car.reports = True
    rig.run(0.3)
    assert rig.cause == "can_silent"
    assert rig.gateway.monitors.motion.motion.by_gyro


def test_wheel_speeds_of_one_side_a_fifth_too_low_stop_a_car_that_drives_straight_on() -> None:
    rig = moving()
    rig.car.overrides |= {"wheel_speed_FL": 0.8 * 108.0, "wheel_speed_RL": 0.8 * 108.0}
    rig.run(0.4)
    assert (rig.action, rig.cause) == (FailsafeAction.CONTROLLED_STOP, "wheel_speed_wrong")


def test_an_estimator_that_was_gone_and_comes_back_is_not_used_again_until_the_car_stands() -> None:
    """It has missed what happened, and the gateway has not."""
    rig = moving()
    rig.estimator_runs = False
    rig.run(0.3)
    assert rig.cause == "estimate_invalid"
    rig.estimator_runs, rig.aside = True, 5.0
    rig.run(0.3)
    assert not rig.gateway.monitors.estimate_fits
    assert abs(pose(rig).y) < 0.1
    while rig.car.speed > 0.0:
        rig.step()
    rig.run(0.1)
    assert rig.gateway.monitors.estimate_fits


@pytest.mark.parametrize("held_s", [0.3, 2.0])
def test_a_gateway_that_was_held_up_itself_goes_by_the_estimate_again(held_s: float) -> None:
    """It does not know where the car went meanwhile."""
    rig = moving()
    rig.gateway_runs = False
    rig.run(held_s)
    rig.gateway_runs, rig.aside = True, 1.0
    rig.run(0.3)
    assert rig.action is FailsafeAction.EMERGENCY_STOP
    assert abs(pose(rig).x - rig.car.x) < 1.0
    assert pose(rig).y > 0.5


def test_an_estimate_of_an_old_state_moves_no_stop() -> None:
    """What waited for an estimator that was held up is answered when the car is elsewhere."""
    rig = moving()
    rig.estimator_runs = False
    old = rig.estimate(rig.now_ns)
    rig.run(0.3)
    assert rig.cause == "estimate_invalid"
    rig.bus.publish(topics.ESTIMATE, old)
    rig.run(0.01)
    assert abs(pose(rig).x - rig.car.x) < 1.0
