"""Swapped axles are found by the slip of the driven wheels; tyres and radii of another car are not taken for them."""

from __future__ import annotations

import math

import pytest
from support.cars.scripted_car import Rig

from hil_gateway.bus.messages import VehicleState
from hil_gateway.config import Config
from hil_gateway.gateway.perceive.monitors.sensors import AxleMonitor

CONFIG = Config()
SPEED = 40.0
SLIP = 0.006
"""of slicks, a m/s2"""


def driven_at(acceleration: float, slip: float, radii: float = 0.0, steer: float = 0.0) -> VehicleState:
    """`slip`: of the driven wheels a m/s2; `radii`: by how much the rear wheels turn faster while they roll."""
    rig = Rig()
    rig.run(0.05)
    car = CONFIG.vehicle
    yaw_rate = SPEED * math.tan(steer) / car.wheelbase
    front = SPEED * math.cos(steer) + car.wheelbase * yaw_rate * math.sin(steer)
    rear = SPEED * (1.0 + radii) * (1.0 + slip * acceleration)
    drag = 0.5 * car.air_density * car.drag_area * SPEED**2 / car.mass
    return rig.gateway.seen[0].model_copy(
        update={
            "drive": acceleration * car.mass / CONFIG.powertrain.force_per_drive, "ax": acceleration - drag,
            "steer": steer, "yaw_rate": yaw_rate,
            "wheel_speed_fl": front, "wheel_speed_fr": front, "wheel_speed_rl": rear, "wheel_speed_rr": rear,
        }
    )  # fmt: skip


def noticed_s(*states: VehicleState) -> float:
    """Time for which swapped axles are seen at the end of one second of each of `states`."""
    monitor, held_s = AxleMonitor(CONFIG), 0.0
    for tick in range(100 * len(states)):
        held_s = monitor.step(tick * 10_000_000, states[tick // 100], SPEED)
    return held_s


def swapped(state: VehicleState) -> VehicleState:
    return state.model_copy(
        update={
            "wheel_speed_fl": state.wheel_speed_rl, "wheel_speed_fr": state.wheel_speed_rr,
            "wheel_speed_rl": state.wheel_speed_fl, "wheel_speed_rr": state.wheel_speed_fr,
        }
    )  # fmt: skip


@pytest.mark.parametrize("acceleration", [2.5, 7.0])
@pytest.mark.parametrize("radii", [-0.02, 0.0, 0.02])
def test_swapped_axles_are_found_within_half_a_second_of_power(acceleration: float, radii: float) -> None:
    rolls, driven = driven_at(0.0, SLIP, radii), driven_at(acceleration, SLIP, radii)
    assert noticed_s(swapped(rolls), swapped(driven)) > 0.5
    assert noticed_s(rolls, swapped(rolls), swapped(driven)) > 0.5


@pytest.mark.parametrize("slip", [0.0, 0.003, 0.012])
@pytest.mark.parametrize("radii", [-0.03, 0.0, 0.03])
@pytest.mark.parametrize("steer", [0.0, 0.15])
def test_axles_that_are_not_swapped_drive_on_whatever_tyres_and_radii(slip: float, radii: float, steer: float) -> None:
    states = driven_at(0.0, slip, radii, steer), driven_at(5.0, slip, radii, steer)
    assert noticed_s(*states) == 0.0


@pytest.mark.parametrize("acceleration", [0.0, 1.0, -8.0])
def test_a_car_that_is_not_driven_says_nothing_of_its_axles(acceleration: float) -> None:
    assert noticed_s(driven_at(acceleration, -SLIP)) == 0.0
