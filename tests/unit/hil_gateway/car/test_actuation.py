"""Conversions around the actuators: geodesy, engine map, gears, pedals and their inverse."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil_gateway.car.actuation import Actuation, ActuatorPositions, brake_balance
from hil_gateway.car.car import load_car
from hil_gateway.car.powertrain import RPM, GearChoice
from hil_gateway.config import OriginConfig
from hil_gateway.track.geodesy import LocalMap

TRAIN, VEHICLE = load_car().powertrain, load_car().vehicle
ACTUATION = Actuation(VEHICLE, TRAIN)
distances = st.floats(-8000, 8000)


@given(distances, distances)
def test_map_and_geodetic_are_inverse(x, y):
    there = LocalMap(OriginConfig())
    assert there.to_map(*there.to_geodetic(x, y)) == pytest.approx((x, y), abs=1e-6)


def test_one_minute_of_latitude_is_a_nautical_mile_and_east_is_x():
    there = LocalMap(OriginConfig(latitude=45.0, longitude=10.0))
    x, y = there.to_map(45.0 + 1 / 60, 10.0)
    assert (x, y) == (pytest.approx(0, abs=1e-6), pytest.approx(1852.2, abs=0.5))  # WGS 84 at 45 degrees
    x, y = there.to_map(45.0, 10.0 + 1 / 60)
    assert x == pytest.approx(1314.2, abs=0.5)
    assert abs(y) < 0.2


@given(st.floats(-0.27, 0.27), st.floats(-0.35, 0.12), st.integers(1, 6), st.floats(250, 700))
def test_the_inverse_gives_back_the_command_within_what_the_car_can_do(steer, drive, gear, engine_speed):
    actuators = ACTUATION.to_actuators(steer, drive, gear, engine_speed, gear)
    assert ACTUATION.to_steer(actuators.steering_motor) == pytest.approx(steer)
    back = ACTUATION.to_drive(actuators, engine_speed, gear)
    if actuators.accelerator < 1.0 and actuators.brake_front < TRAIN.brake_pressure_max:
        assert back == pytest.approx(drive, abs=1e-9)
    else:
        assert abs(back) <= abs(drive)


def test_pressures_are_split_by_the_declared_bias_and_capped():
    half = ACTUATION.to_actuators(0.0, -0.1, 3, 500.0, 3)
    assert half.brake_front / (half.brake_front + half.brake_rear) == pytest.approx(0.54)
    assert half.accelerator == 0.0
    full = ACTUATION.to_actuators(0.0, -9.9, 3, 500.0, 3)
    assert full.brake_front == full.brake_rear == TRAIN.brake_pressure_max


@given(st.floats(100.0, 12_000.0), st.floats(-1.0, 1.0))
def test_a_commanded_balance_moves_pressure_between_the_axles_and_never_far_from_the_declared(force, balance):
    declared, asked = ACTUATION.brake_pressures(force), ACTUATION.brake_pressures(force, balance)
    assert sum(asked) == pytest.approx(sum(declared))
    share = asked[0] / sum(asked)
    assert 0.54 - 0.12 - 1e-9 <= share <= 0.54 + 0.12 + 1e-9
    if 0.42 <= 0.5 + 0.5 * balance <= 0.66:
        assert (asked[0] - asked[1]) / sum(asked) == pytest.approx(balance)


def test_brakes_that_are_not_pressed_have_no_balance():
    assert brake_balance(3e6, 2e6) == pytest.approx(0.2)
    assert abs(brake_balance(900.0, -900.0)) < 0.02, "noise of two sensors"


def test_neutral_drives_nothing():
    assert ACTUATION.to_actuators(0.0, 0.1, 0, 500.0, 1) == ActuatorPositions(0.0, 0.0, 0.0, 0.0, 1)
    assert ACTUATION.to_drive(ActuatorPositions(0.0, 1.0, 0.0, 0.0, 0), 500.0, 0) == 0.0


def test_473_hp_at_6110_rpm():
    speed = 6110 * RPM
    assert TRAIN.engine_torque_at(speed) * speed == pytest.approx(473 * 745.7, rel=0.01)


def test_the_engine_map_is_held_at_its_ends():
    assert TRAIN.engine_torque_at(0.0) == TRAIN.engine_torque_at(TRAIN.clutch_rpm * RPM)
    assert TRAIN.engine_torque_at(9999 * RPM) == TRAIN.engine_torque[-1]


def test_every_gear_is_used_once_up_and_once_down_without_hunting():
    gears = GearChoice(TRAIN, VEHICLE.wheel_radius)
    speeds = [0.1 * i for i in range(850)]
    up = [gears.step(int(i * 1e8), speed, 0.0, 0) for i, speed in enumerate(speeds)]
    down = [gears.step(int((1000 + i) * 1e8), speed, 0.0, 0) for i, speed in enumerate(reversed(speeds))]
    assert up == sorted(up)
    assert down == sorted(down, reverse=True)
    assert set(up) == set(down) == {1, 2, 3, 4, 5, 6}


def test_wheel_sensors_that_read_zero_do_not_turn_the_engine_faster_than_its_map_ends():
    gears = GearChoice(TRAIN, VEHICLE.wheel_radius)
    for i in range(100):
        gear = gears.step(int(i * 1e8), 45.0, 0.0, 0)
    engine_speed = 45.0 / VEHICLE.wheel_radius * TRAIN.ratio(gear)
    for i in range(100, 200):
        assert gears.step(int(i * 1e8), 0.0, engine_speed, gear) == gear
    slow = engine_speed / 3
    assert gears.step(int(200 * 1e8), 0.0, slow, gear) == gear - 1


@pytest.mark.parametrize("speed", [26.0, 38.0, 50.0, 62.0, 71.0])
def test_a_noisy_constant_speed_does_not_shift_back_and_forth(speed):
    gears = GearChoice(TRAIN, VEHICLE.wheel_radius)
    chosen = [gears.step(int(i * 1e8), speed + 0.5 * math.sin(i), 0.0, 0) for i in range(400)]
    shifts = sum(a != b for a, b in pairwise(chosen[60:]))
    assert shifts == 0
