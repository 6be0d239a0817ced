"""The IMU's gain against how steering and front wheels both say the car turns."""

from __future__ import annotations

import math
import random
from collections.abc import Callable

import pytest
from support.scripted_car import Rig

from hil_gateway.bus.messages import VehicleState
from hil_gateway.config import Config
from hil_gateway.gateway.perceive.monitors.gain import JUDGED_FROM, GainMonitor, Others

CONFIG = Config()
SPEED = 70.0
BEND = 0.3
"""rad/s"""
PER_DRIVE = CONFIG.powertrain.force_per_drive / CONFIG.vehicle.mass
DRAG = 0.5 * CONFIG.vehicle.air_density * CONFIG.vehicle.drag_area / CONFIG.vehicle.mass
Curve = Callable[[float], float]


@pytest.fixture
def state() -> VehicleState:
    rig = Rig()
    rig.run(0.2)
    seen = rig.gateway.seen
    assert seen is not None
    return seen[0]


def turning_in(t: float) -> float:
    """A straight, and from 0.5 s on a bend that begins as fast roads turn, rad/s."""
    return min(max(t - 0.5, 0.0) * 0.2, BEND)


class Drive:
    """A car at `speed` whose readings and witnesses have gains of their own, with the noise of real ones."""

    def __init__(self, state: VehicleState, speed: float = SPEED, stopping: bool = False) -> None:
        self._state, self._rng = state, random.Random(1)
        self.speed, self.stopping, self.monitor = speed, stopping, GainMonitor(CONFIG)
        self.angle = 0.0
        """that the car has turned by, rad"""

    def turn(
        self, rate: float, gyro: float = 1.0, force: float = 1.0, steering: float = 1.0, wheels: float = 1.0
    ) -> bool:
        """A period in which the car turns with `rate`, rad/s: whether the monitor has found something."""
        others = Others(steering * rate, wheels * rate + self._noise(0.003 * self.speed / 1.6), self.speed)
        self.angle += 0.01 * rate
        return self._step(gyro * rate, self.speed * force * rate, 0.0, 0.0, others)

    def push(self, pushed: float, gained: float, felt: float, gyro: float = 0.0) -> bool:
        """A period in which engine or brakes push, wheels gain speed and the IMU feels, m/s2."""
        self.speed += 0.01 * gained
        others = Others(gyro, gyro, self.speed + self._noise(0.003 * self.speed / 1.4))
        return self._step(gyro, self.speed * gyro, felt, (pushed + DRAG * self.speed**2) / PER_DRIVE, others)

    def _step(self, yaw_rate: float, ay: float, ax: float, drive: float, others: Others) -> bool:
        read = {"yaw_rate": yaw_rate + self._noise(1.5e-3), "ax": ax + self._noise(0.1), "drive": drive}
        state = self._state.model_copy(update=read)
        self.monitor.step(state, self.speed, ay + self._noise(0.1), others, self.stopping)
        return self.monitor.found

    def _noise(self, deviation: float) -> float:
        return self._rng.gauss(0.0, deviation)

    def noticed(self, rate: Curve, **gains: float) -> float:
        """Time after which it is found, s; infinite if it is not within 20 s. Before, all is right for 0.2 s."""
        assert not any(self.turn(rate(0.0)) for _ in range(20))
        self.angle = 0.0
        return next((0.01 * n for n in range(2000) if self.turn(rate(0.01 * n), **gains)), math.inf)


def test_a_sound_imu_is_believed_on_a_straight_and_in_a_bend(state):
    assert math.isinf(Drive(state).noticed(turning_in))
    assert math.isinf(Drive(state).noticed(lambda t: BEND * math.sin(2.0 * t)))


@pytest.mark.parametrize("gain", [-1.0, 0.0])
def test_a_gyro_of_another_gain_is_found_in_a_bend_at_once(state, gain):
    assert Drive(state).noticed(lambda t: BEND, gyro=gain) <= 0.05  # its filter


@pytest.mark.parametrize(("gyro", "force"), [(-1.0, 1.0), (-1.0, -1.0), (0.0, 0.0), (1.0, -1.0)])
def test_one_that_went_wrong_on_a_straight_is_found_before_the_heading_is_wrong_by_a_twentieth(state, gyro, force):
    drive = Drive(state)
    assert drive.noticed(turning_in, gyro=gyro, force=force) < 1.2
    assert drive.angle * (1.0 - gyro) < 0.05


def test_a_steering_zero_and_uneven_wheels_on_a_long_straight_say_nothing(state):
    drive = Drive(state)
    others = Others(0.015, 0.015, drive.speed)
    rolls = DRAG * drive.speed**2 / PER_DRIVE
    assert not any(drive._step(0.0, 0.0, 0.0, rolls, others) for _ in range(2000))


def test_steering_and_wheels_that_contradict_each_other_blame_nothing(state):
    """A slide that is caught: the wheels say how the car turns, the steering the other side; and swapped wheels."""
    assert math.isinf(Drive(state).noticed(lambda t: BEND, steering=-1.0))
    assert math.isinf(Drive(state).noticed(lambda t: BEND, wheels=-1.0))


@pytest.mark.parametrize("wrong", ["steering", "wheels"])
def test_a_turn_that_one_of_them_exaggerates_blames_nothing(state, wrong):
    assert math.isinf(Drive(state).noticed(lambda t: BEND, **{wrong: 3.0}))


def test_wheels_and_steering_that_both_exaggerate_in_a_stop_blame_nothing(state):
    """Inner wheels that brake slip, and a report of the steering may hang."""
    assert math.isinf(Drive(state, stopping=True).noticed(lambda t: 0.1, steering=4.0, wheels=4.0))


def test_the_other_sign_is_found_in_a_stop_too(state):
    assert Drive(state, stopping=True).noticed(lambda t: BEND, gyro=-1.0) < 0.1


def test_a_slow_car_is_not_judged(state):
    assert math.isinf(Drive(state, speed=JUDGED_FROM - 1.0).noticed(lambda t: BEND, gyro=-1.0))


@pytest.mark.parametrize(("pushed", "within_s"), [(1.5, 0.6), (-10.0, 0.2)])
def test_an_imu_that_feels_braking_as_pushing_is_found_on_a_straight(state, pushed, within_s):
    drive = Drive(state)
    assert not any(drive.push(pushed, pushed, pushed) for _ in range(100))
    assert any(drive.push(pushed, pushed, -pushed) for _ in range(int(100 * within_s)))


@pytest.mark.parametrize(
    ("pushed", "gained", "felt"), [(-10.0, 0.0, 0.0), (-20.0, -25.0, -6.0), (2.0, 2.0, 0.2), (2.0, -1.0, -1.0)],
    ids=["dead brakes", "wheels that lock on wet ground", "a climb", "an engine that stalls"],
)  # fmt: skip
def test_what_cars_do_on_a_straight_is_no_wrong_imu(state, pushed, gained, felt):
    drive = Drive(state)
    assert not any(drive.push(pushed, gained, felt) for _ in range(150))


def test_an_inner_wheel_that_slips_under_the_brakes_as_the_car_turns_back_blames_nothing(state):
    """Car 7106 of the simulated ones: the steering is late, and wheels say what the lateral force makes of the slip."""
    drive = Drive(state, speed=53.0)
    braked = state.model_copy(update={"drive": -10.0 / PER_DRIVE, "ax": -10.0, "yaw_rate": -0.05})
    for _ in range(100):
        drive.monitor.step(braked, 53.0, 5.0, Others(0.05, 0.3, 53.0), False)
    assert not drive.monitor.found


def test_side_slip_that_goes_as_a_car_leaves_a_bend_blames_no_accelerometer(state):
    """Car 7117 of the simulated ones: it has turned back already, and the force still points to the inside."""
    drive = Drive(state)
    turned = state.model_copy(update={"yaw_rate": -0.035, "ax": 0.0})
    for _ in range(100):
        drive.monitor.step(turned, SPEED, 4.0, Others(-0.08, -0.03, SPEED), False)
    assert not drive.monitor.found


def test_it_holds_until_the_car_stands(state):
    drive = Drive(state)
    drive.noticed(lambda t: BEND, gyro=-1.0)
    assert all(drive.turn(BEND - 0.005 * n, gyro=-1.0) for n in range(30))
    drive.monitor.step(state, SPEED, 0.0, None, False)
    assert drive.monitor.found and drive.monitor.repair is not None
    drive.monitor.step(state, 0.0, 0.0, None, False)
    assert not drive.monitor.found and drive.monitor.repair is None


@pytest.mark.parametrize(
    ("gyro", "force", "sign", "across"), [(-1.0, -1.0, -1.0, -1.0), (-1.0, 1.0, -1.0, 1.0), (1.0, -1.0, 1.0, -1.0)]
)
def test_a_wrong_sign_is_taken_back(state, gyro, force, sign, across):
    drive = Drive(state)
    drive.noticed(turning_in, gyro=gyro, force=force)
    for _ in range(20):
        drive.turn(BEND, gyro=gyro, force=force)
    assert drive.monitor.repair is not None
    assert (drive.monitor.repair.sign, drive.monitor.repair.force) == (sign, across)


@pytest.mark.parametrize("gyro", [1.0, -1.0])
def test_found_on_a_straight_the_sign_of_the_gyro_is_told_in_the_next_bend(state, gyro):
    drive = Drive(state)
    assert any(drive.push(-10.0, -10.0, 10.0) for _ in range(50))
    assert drive.monitor.repair is None
    drive.stopping = True
    for _ in range(20):
        drive.turn(BEND, gyro=gyro, force=-1.0)
    assert drive.monitor.repair is not None
    assert (drive.monitor.repair.sign, drive.monitor.repair.force) == (gyro, -1.0)


@pytest.mark.parametrize("force", [1.0, 0.0], ids=["alone", "with the accelerometers, which are found first"])
def test_a_gyro_that_shows_nothing_cannot_be_repaired(state, force):
    """Not by what its filter keeps of the bend it went wrong in."""
    drive = Drive(state)
    drive.noticed(lambda t: BEND, gyro=0.0, force=force)
    for _ in range(100):
        drive.turn(BEND, gyro=0.0, force=force)
    assert drive.monitor.repair is None


def test_a_gyro_that_hangs_is_not_right_because_it_still_shows_nearly_what_the_car_does(state):
    """The accelerometers hang too, and are found first; the bend opens."""
    drive = Drive(state)
    assert any(drive.turn(BEND, force=-1.0) for _ in range(20))
    for n in range(30):
        rate = BEND - 0.005 * n
        drive.turn(rate, gyro=BEND / rate, force=BEND / rate)
    assert drive.monitor.repair is None


def test_a_gyro_that_was_found_is_not_right_as_it_is(state):
    """It hangs, and shows what the car happens to do as the bend opens."""
    drive = Drive(state)
    drive.noticed(lambda t: BEND, gyro=0.4)
    for _ in range(100):
        drive.turn(0.4 * BEND, gyro=1.0)
    assert drive.monitor.repair is None
