"""The double-track car that diagnoses are judged by: its forces where they can be worked out by hand."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
import pytest
from support.drives.practice_drives import practice

SPEED = 50.0


@pytest.fixture(scope="module")
def module() -> Any:
    practice()
    return importlib.import_module("practice.double_track")


def rolling(module: Any, **changed: float) -> Any:
    """One car straight ahead at `SPEED`, wheels without slip."""
    zero = np.zeros(1)
    names = ("share", "offset", "mu", "yaw", "vx", "vy", "rate")
    moving = {name: zero + changed.get(name, 0.0) for name in names} | {"vx": zero + SPEED}
    return module.State(**moving, kappa=np.zeros((4, 1)), alpha=np.zeros((4, 1)), felt=np.zeros((2, 1)))


def pedals(module: Any, **pressed: float) -> Any:
    return module.Pedals(*(np.array([pressed.get(name, 0.0)]) for name in ("steer", "throttle", "brake")))


def test_a_car_straight_ahead_has_its_weight_its_downforce_and_its_drag(module: Any) -> None:
    car, setup = module.DoubleTrack([module.Setup()], [1]), module.Setup()
    state = rolling(module)
    loads = car.loads(state, (np.zeros(1),) * 4)
    assert loads.sum() == pytest.approx(787.0 * 9.80665 + sum(setup.downforce) * SPEED**2)
    assert (loads[:2].sum() - setup.downforce[0] * SPEED**2) * 1.7238 == pytest.approx(
        (loads[2:].sum() - setup.downforce[1] * SPEED**2) * 1.248
    )
    found = car.forces(state, pedals(module))
    assert (found.ax[0], found.ay[0], found.yaw_acc[0]) == pytest.approx((-setup.drag * SPEED**2 / 787.0, 0.0, 0.0))


def test_a_bank_that_leans_into_the_turn_presses_the_car_down(module: Any) -> None:
    car, bend = module.DoubleTrack([module.Setup()], [1]), 0.01
    flat, banked = (
        car.loads(rolling(module), (np.array([bend]), np.array([bank]), np.zeros(1), np.zeros(1))).sum()
        for bank in (0.0, -0.3)
    )
    pressed = 787.0 * (9.80665 * (np.cos(0.3) - 1.0) + SPEED**2 * bend * np.sin(0.3))
    assert banked - flat == pytest.approx(pressed)


def test_brakes_act_on_the_axles_as_set_up_and_the_engine_up_to_its_power(module: Any) -> None:
    setup = module.Setup(brake_front=0.6, engine_braking=0.0)
    car = module.DoubleTrack([setup], [1])
    braked = car.torques(rolling(module), pedals(module, brake=1.0), np.zeros((4, 1)))
    assert braked[:2].sum() == pytest.approx(-0.6 * module.BRAKE_FORCE)
    assert braked[2:].sum() == pytest.approx(-0.4 * module.BRAKE_FORCE)
    driven = car.torques(rolling(module), pedals(module, throttle=1.0), np.zeros((4, 1)))
    assert driven.sum() == pytest.approx(setup.power / SPEED)


def test_left_and_right_turns_mirror_each_other(module: Any) -> None:
    car = module.DoubleTrack([module.Setup()], [1])
    found = []
    for side in (1.0, -1.0):
        state = rolling(module, vy=-0.5 * side, rate=0.2 * side)
        state.alpha = np.full((4, 1), 0.03 * side)
        found.append(car.forces(state, pedals(module, steer=0.02 * side)))
    assert found[0].ax == pytest.approx(found[1].ax)
    assert (found[0].ay[0], found[0].yaw_acc[0]) == pytest.approx((-found[1].ay[0], -found[1].yaw_acc[0]))
    assert abs(found[0].ay[0]) > 5.0
