"""An IMU whose axes have lost their noise is found."""

from __future__ import annotations

import random
from dataclasses import replace

import pytest
from support.cars.scripted_car import reported_state

from hil_gateway.bus.messages import VehicleState
from hil_gateway.car.car import load_car
from hil_gateway.gateway.perceive.monitors.imu import USUAL, WINDOW, QuietMonitor

GYRO_NOISE, FORCE_NOISE = 0.0015, 0.11
"""rad/s and m/s2, as the plant's IMU has it"""
SPEED = 60.0


@pytest.fixture
def state() -> VehicleState:
    return reported_state()


class Drive:
    """Readings with noise, one period after the other."""

    def __init__(self, state: VehicleState) -> None:
        self._state, self._rng = state, random.Random(1)
        self.monitor = QuietMonitor(load_car())

    def read(self, noise: float = 1.0, motion: float = 0.0, age_s: float = 0.0) -> bool:
        draw = self._rng.gauss
        forces = {name: motion + noise * draw(0.0, FORCE_NOISE) for name in ("ay", "ax")}
        yaw_rate = 0.02 * motion + noise * draw(0.0, GYRO_NOISE)
        sources = self._state.sources | {"imu": replace(self._state.sources["imu"], age_s=age_s)}
        self.monitor.step(self._state.model_copy(update={"yaw_rate": yaw_rate, "sources": sources, **forces}), SPEED)
        return self.monitor.found


@pytest.mark.parametrize(("noise", "found"), [(0.02, True), (0.5, False)])
def test_an_imu_that_has_lost_its_noise_is_found_and_stays_so_until_the_car_stands(
    state: VehicleState, noise: float, found: bool
) -> None:
    drive = Drive(state)
    assert not any(drive.read() for _ in range(USUAL + WINDOW + 3))
    assert any(drive.read(noise) for _ in range(2 * WINDOW)) == found
    assert drive.read() == found
    drive.monitor.step(state, 0.0)
    assert not drive.monitor.found


def test_before_the_usual_noise_is_known_none_is_missed(state: VehicleState) -> None:
    drive = Drive(state)
    assert not any(drive.read(noise) for noise in [1.0] * (USUAL // 2) + [0.02] * (2 * WINDOW))


@pytest.mark.parametrize("missed", [1, 2, 4])
def test_frames_that_a_busy_bus_holds_back_are_no_lost_noise(state: VehicleState, missed: int) -> None:
    drive = Drive(state)
    assert not any(drive.read() for _ in range(USUAL + WINDOW + 3))
    assert not any(drive.read(age_s=0.01 * (n % (missed + 1))) for n in range(200))
