"""The IMU against itself: steps that no car makes, and axes without their noise."""

from __future__ import annotations

import random
from dataclasses import replace

import pytest
from support.cars.scripted_car import reported_state

from hil_gateway.bus.messages import VehicleState
from hil_gateway.car.car import Car, load_car
from hil_gateway.gateway.perceive.monitors.imu import STEADY, USUAL, ImuMonitor
from hil_gateway.gateway.perceive.received import STUCK_FRAMES
from hil_gateway.settings.gateway import PERIOD_NS

GYRO_NOISE, FORCE_NOISE = 0.0015, 0.11
"""rad/s and m/s2, as the plant's IMU has it"""
SPEED = 60.0


@pytest.fixture
def state() -> VehicleState:
    return reported_state()


class Drive:
    """Readings with noise, one period after the other."""

    def __init__(self, state: VehicleState, car: Car | None = None) -> None:
        self._state, self._rng = state, random.Random(1)
        self.now_ns = 0
        self.monitor = ImuMonitor(car or load_car())

    def read(self, turn: float, ay: float, ax: float, noise: float = 1.0, age_s: float = 0.0) -> bool:
        draw = self._rng.gauss
        yaw_rate = turn + noise * draw(0.0, GYRO_NOISE)
        forces = {name: force + noise * draw(0.0, FORCE_NOISE) for name, force in (("ay", ay), ("ax", ax))}
        sources = self._state.sources | {"imu": replace(self._state.sources["imu"], age_s=age_s)}
        self.now_ns += PERIOD_NS
        reported = {"stamp_ns": self.now_ns, "yaw_rate": yaw_rate, "sources": sources, **forces}
        self.monitor.step(self._state.model_copy(update=reported), SPEED)
        return self.monitor.found

    def steps(self, before: tuple[float, float, float], after: tuple[float, float, float]) -> bool:
        """Whether it is found within `STEADY` periods."""
        assert not any(self.read(*before) for _ in range(20))
        return any(self.read(*after) for _ in range(STEADY))


@pytest.mark.parametrize(
    "after", [(0.42, 9.0, -6.0), (-0.12, -9.0, 6.0), (0.0, 0.2, -0.1), (0.12, -9.0, 6.0)],
    ids=["an offset of the yaw rate", "a wrong sign", "a wrong scale", "turned around"],
)  # fmt: skip
def test_readings_that_step_as_no_car_moves_are_found_at_once(state, after):
    assert Drive(state).steps((0.12, 9.0, -6.0), after)


def test_what_changed_while_nobody_read_is_no_step(state):
    drive, before, after = Drive(state), (-0.05, -2.2, -13.0), (-0.1, -3.6, -16.3)
    assert not any(drive.read(*before) for _ in range(20))
    drive.now_ns += 7 * PERIOD_NS
    assert not any(drive.read(*after) for _ in range(STEADY))


def test_less_grip_from_one_period_to_the_next_is_no_wrong_imu(state):
    assert not Drive(state).steps((0.3, 18.0, -8.0), (0.3, 12.0, -4.0))


def test_a_gear_shift_is_no_wrong_imu(state):
    assert not Drive(state).steps((0.0, 0.0, 6.0), (0.0, 0.0, -3.0))


def test_a_gear_shift_that_turns_the_car_a_little_is_no_wrong_imu(state):
    """Rear tyres that no longer push hold more: 1.3 deg/s less in one period, at 38 m/s."""
    drive = Drive(state)
    assert not any(drive.read(0.3, 10.7, 8.2, noise=0.3) for _ in range(20))
    assert not any(drive.read(0.275, 10.9, -0.6, noise=0.3) for _ in range(STEADY))


def _with_a_better_imu(car: Car) -> Car:
    name, imu = next(iter(car.imus.items()))
    better = imu.model_copy(update={"rate_noise": 0.05 * imu.rate_noise, "acceleration_noise": 0.0})
    return car.model_copy(update={"imus": {name: better}})


def test_a_gear_shift_in_a_bend_is_no_wrong_imu_however_good_its_data_sheet_is(state):
    drive = Drive(state, _with_a_better_imu(load_car()))
    readings = [(0.092, 4.5, 6.1)] * 10 + [(0.088, 4.9, -1.1)] + [(0.085, 4.9, -2.4)] * 10
    assert not any(drive.read(*reading, noise=0.01) for reading in readings)


def test_a_car_that_begins_to_spin_is_no_wrong_imu(state):
    """10 rad/s2 of yaw acceleration."""
    drive = Drive(state)
    assert not any(drive.read(0.2, 15.0, -8.0) for _ in range(20))
    assert not any(drive.read(0.2 + 0.1 * n, 15.0 - n, -8.0) for n in range(20))


def test_a_kerb_is_no_wrong_imu(state):
    drive = Drive(state)
    readings = [(0.1, 8.0, -2.0)] * 10 + [(0.25, 20.0, 6.0)] + [(0.1, 8.0, -2.0)] * 10
    assert not any(drive.read(*reading) for reading in readings)


@pytest.mark.parametrize("missed", [1, 2, 4])
def test_frames_that_a_busy_bus_holds_back_while_the_car_turns_in_are_no_wrong_imu(state, missed):
    """2 rad/s2 and 100 m/s3: what has changed since the last frame comes at once."""
    drive = Drive(state)
    for n in range(60):
        behind = n - 30 + 1 if 30 <= n < 30 + missed else 0
        turned = n - behind
        assert not drive.read(0.02 * turned, 1.0 * turned, -2.0, noise=0.0, age_s=0.01 * behind)


@pytest.mark.parametrize(("noise", "found"), [(0.02, True), (0.5, False)])
def test_an_imu_that_has_lost_its_noise_is_found(state, noise, found):
    drive = Drive(state)
    assert not any(drive.read(0.0, 0.0, 0.0) for _ in range(USUAL + STUCK_FRAMES + 3))
    assert any(drive.read(0.0, 0.0, 0.0, noise) for _ in range(2 * STUCK_FRAMES)) == found


def test_what_was_found_holds_until_the_car_stands(state):
    drive = Drive(state)
    assert drive.steps((0.12, 9.0, -6.0), (-0.12, -9.0, 6.0))
    assert drive.read(-0.12, -9.0, 6.0)
    drive.monitor.step(state, 0.0)
    assert not drive.monitor.found
