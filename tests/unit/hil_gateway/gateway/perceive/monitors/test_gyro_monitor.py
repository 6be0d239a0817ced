"""The gyro is outvoted where it lies, and not by a car that oversteers, nor by wheels of one side that lie."""

from __future__ import annotations

import pytest
from support.scripted_car import Rig

from hil_gateway.bus.messages import VehicleState
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.gateway.perceive.monitors.sensors import GyroMonitor, SideMonitor

SPEED, LATERAL = 67.0, 24.5
TURN = LATERAL / SPEED
"""m/s, m/s2 and rad/s of a bend of 2.5 g"""


def in_a_bend(steer: float, gyro: float) -> VehicleState:
    """Front wheels show the whole of the turn."""
    rig = Rig()
    rig.run(0.05)
    half = 0.5 * Vehicle().track_front * TURN
    return rig.gateway.seen[0].model_copy(
        update={
            "steer": steer, "yaw_rate": gyro, "ay": LATERAL, "drive": 0.05,
            "wheel_speed_fl": SPEED - half, "wheel_speed_fr": SPEED + half,
        }
    )  # fmt: skip


def outvoted_s(state: VehicleState, rear: float, speed: float = SPEED) -> float:
    """`rear`: the turn by the rear wheels; those that slide show too little."""
    monitor, held_s = GyroMonitor(Vehicle()), 0.0
    for tick in range(100):
        held_s = monitor.step(tick * 10_000_000, state, speed, rear, state.ay, stopping=False)
    return held_s


@pytest.mark.parametrize("steer", [0.0, -0.002, 0.002])
def test_a_car_that_oversteers_through_a_bend_with_straight_wheels_keeps_its_gyro(steer: float) -> None:
    assert outvoted_s(in_a_bend(steer, TURN + 0.1), 0.3 * TURN) == 0.0


@pytest.mark.parametrize("offset", [0.3, -0.3])
def test_a_gyro_that_is_off_by_0_3_rad_s_is_outvoted_in_the_same_bend(offset: float) -> None:
    assert outvoted_s(in_a_bend(0.004, TURN + offset), TURN) > 0.9


def braking_into_a_bend(gyro: float) -> VehicleState:
    """At 72 m/s with front tyres near their peak: wheels turned far in, and the inner ones slip."""
    return in_a_bend(0.0436, gyro).model_copy(update={"ay": 19.1, "drive": -0.075})


def test_a_car_at_its_limit_that_brakes_into_a_fast_bend_keeps_its_gyro() -> None:
    """0.184 rad/s at 19.1 m/s2 is what the simulated car does there for 0.1 s."""
    assert outvoted_s(braking_into_a_bend(0.184), 0.39, 72.5) == 0.0


def test_a_gyro_that_is_off_by_0_2_rad_s_is_outvoted_there() -> None:
    assert outvoted_s(braking_into_a_bend(0.184 - 0.2), 0.39, 72.5) > 0.9


def sided_s(update: dict[str, float]) -> float:
    """How long the wheels of one side are held against those of the other, s."""
    half = 0.5 * Vehicle().track_rear * TURN
    rear = {"wheel_speed_rl": SPEED - half, "wheel_speed_rr": SPEED + half}
    state, monitor, held_s = in_a_bend(0.004, TURN).model_copy(update=rear | update), SideMonitor(Vehicle()), 0.0
    for tick in range(30):
        held_s = monitor.step(tick * 10_000_000, state, SPEED, state.ay)
    return held_s


@pytest.mark.parametrize("share", [0.8, 1.2])
def test_wheels_of_one_side_that_are_a_fifth_wrong_are_named_within_0_2_s(share: float) -> None:
    assert sided_s({"wheel_speed_fl": share * SPEED, "wheel_speed_rl": share * SPEED}) > 0.2


@pytest.mark.parametrize(
    "update",
    [
        {"wheel_speed_fl": 0.96 * SPEED, "wheel_speed_rl": 0.96 * SPEED},
        {"wheel_speed_rl": 1.3 * SPEED},
        {"wheel_speed_fl": 0.8 * SPEED, "wheel_speed_rl": 0.8 * SPEED, "drive": -0.1},
        {"wheel_speed_fl": 0.8 * SPEED, "wheel_speed_rl": 0.8 * SPEED, "ay": LATERAL - 10.0},
    ],
)
def test_worn_tyres_a_wheel_that_spins_inner_wheels_that_brake_and_a_slide_are_not(update: dict[str, float]) -> None:
    assert sided_s(update) == 0.0
