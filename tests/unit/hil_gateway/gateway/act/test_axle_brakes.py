"""Brakes of a stop, axle by axle."""

from __future__ import annotations

import pytest
from support.cars.scripted_car import Rig

from hil_gateway.car.actuation import Actuation, ActuatorPositions
from hil_gateway.car.car import load_car
from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.gateway.act.axle_brakes import PRESS_AGAIN_S, AxleBrakes, AxleDemand
from hil_gateway.gateway.perceive.motion import Motion
from hil_gateway.settings.gateway import LEAST_SHARE

VEHICLE, TRAIN, GRIP = load_car().vehicle, load_car().powertrain, 1.3
DRAG = 500.0
"""N of the engine with the throttle closed"""
STRAIGHT, BEND = AxleDemand(0.0, False, False), AxleDemand(14.0, False, False)
FLAT = AxleDemand(0.0, flat_front=True, flat_rear=False)


def brakes() -> AxleBrakes:
    return AxleBrakes(load_car(), GRIP)


def asked(deceleration: float) -> ActuatorPositions:
    """As declared."""
    drive = -VEHICLE.mass * deceleration / TRAIN.force_per_drive
    return Actuation(VEHICLE, TRAIN).to_actuators(0.1, drive, 3, 500.0, 3)


def test_mild_braking_on_a_straight_is_as_declared():
    wanted = asked(6.0)
    assert brakes().shared(wanted, STRAIGHT, 30.0) == (wanted.brake_front, wanted.brake_rear)


def test_beside_lateral_force_the_front_brakes_take_over_what_the_rear_tyres_cannot_bear():
    wanted = asked(8.0)
    front, rear = brakes().shared(wanted, BEND, 50.0)
    assert rear < 0.7 * wanted.brake_rear
    assert front > wanted.brake_front
    assert front + rear <= wanted.brake_front + wanted.brake_rear + 1.0


@pytest.mark.parametrize("lateral", [0.0, 8.0, 14.0])
@pytest.mark.parametrize("speed", [15.0, 40.0, 70.0])
def test_the_rear_axle_stays_within_the_friction_circle_of_the_worst_tyres_that_are_declared(speed, lateral):
    wanted = asked(25.0)
    _, rear = brakes().shared(wanted, AxleDemand(lateral, False, False, DRAG), speed)
    force = rear * TRAIN.brake_force_per_pa
    moved = (wanted.brake_front + wanted.brake_rear) * TRAIN.brake_force_per_pa * VEHICLE.cg_height / VEHICLE.wheelbase
    pressed = -0.5 * VEHICLE.air_density * VEHICLE.lift_area_rear * speed**2
    bears = (1.0 - load_car().grip_spread) * GRIP * (VEHICLE.static_load_rear + pressed - moved)
    across = lateral * VEHICLE.static_load_rear / GRAVITY
    least = max(LEAST_SHARE * bears - DRAG, 0.0)
    assert force <= 1.001 * least or (force + DRAG) ** 2 + across**2 <= 1.001 * bears**2


def test_a_flat_rear_tyre_leaves_braking_to_the_front_axle():
    wanted = asked(8.0)
    front, rear = brakes().shared(wanted, AxleDemand(0.0, flat_front=False, flat_rear=True), 60.0)
    assert rear == 0.0
    assert front > wanted.brake_front


def test_a_flat_front_tyre_takes_nothing_over():
    wanted = asked(8.0)
    front, rear = brakes().shared(wanted, AxleDemand(14.0, flat_front=True, flat_rear=False), 50.0)
    assert front == wanted.brake_front
    assert rear < wanted.brake_rear


@pytest.fixture
def rig() -> Rig:
    made = Rig()
    made.run(0.2)
    made.drive = 0.1
    made.drive_off(12.0)
    return made


@pytest.mark.parametrize(("axle", "other"), [("front", "rear"), ("rear", "front")])
def test_an_axle_whose_wheels_slip_is_let_go_and_pressed_again_where_they_roll(rig, axle, other):
    state, car = rig.gateway.seen[0], brakes()
    speeds = {axle[0]: 24.0, other[0]: 30.0}
    slipping = state.model_copy(update={f"wheel_speed_{a}{side}": v for a, v in speeds.items() for side in "lr"})
    wanted, motion = asked(10.0), Motion(30.0)
    for _ in range(20):
        sent = car.step(wanted, FLAT, slipping, motion)
    at_first = car.shared(wanted, FLAT, 30.0)[("front", "rear").index(axle)]
    assert getattr(sent, f"brake_{axle}") < 0.1 * at_first
    assert getattr(sent, f"brake_{other}") == car.shared(wanted, FLAT, 30.0)[("front", "rear").index(other)]
    rolling = state.model_copy(update={f"wheel_speed_{wheel}": 30.0 for wheel in ("fl", "fr", "rl", "rr")})
    for _ in range(1 + int(at_first / TRAIN.brake_pressure_max * PRESS_AGAIN_S / 0.01)):
        sent = car.step(wanted, FLAT, rolling, motion)
    assert getattr(sent, f"brake_{axle}") == pytest.approx(at_first)


def test_front_wheels_that_lock_on_worse_tyres_than_declared_are_let_roll_in_a_sound_car(rig):
    state, car = rig.gateway.seen[0], brakes()
    locked = state.model_copy(update={"wheel_speed_fl": 5.0, "wheel_speed_fr": 5.0})
    locked = locked.model_copy(update={"wheel_speed_rl": 30.0, "wheel_speed_rr": 30.0})
    wanted = asked(12.0)
    for _ in range(20):
        sent = car.step(wanted, STRAIGHT, locked, Motion(30.0))
    assert sent.brake_front < 0.1 * wanted.brake_front
    assert sent.brake_rear == wanted.brake_rear


@pytest.mark.parametrize("slip", [0.0, 0.06])
def test_sound_brakes_whose_wheels_roll_press_as_declared(rig, slip):
    state, car = rig.gateway.seen[0], brakes()
    speeds = {f"wheel_speed_{wheel}": (1.0 - slip) * 30.0 for wheel in ("fl", "fr", "rl", "rr")}
    rolling = state.model_copy(update=speeds)
    for _ in range(20):
        sent = car.step(asked(12.0), STRAIGHT, rolling, Motion(30.0))
    assert sent == asked(12.0)


def test_one_wheel_of_an_axle_that_slips_lets_nothing_go(rig):
    """An inner wheel in a bend, or a sensor that reads too little."""
    state, car = rig.gateway.seen[0], brakes()
    slipping = state.model_copy(update={"wheel_speed_rl": 15.0, "wheel_speed_rr": 30.0})
    slipping = slipping.model_copy(update={"wheel_speed_fl": 30.0, "wheel_speed_fr": 30.0})
    sent = car.step(asked(8.0), FLAT, slipping, Motion(30.0))
    assert (sent.brake_front, sent.brake_rear) == car.shared(asked(8.0), FLAT, 30.0)


def test_a_new_stop_begins_with_whole_pressure(rig):
    state, car = rig.gateway.seen[0], brakes()
    slipping = state.model_copy(update={f"wheel_speed_{wheel}": 20.0 for wheel in ("fl", "fr", "rl", "rr")})
    for _ in range(20):
        car.step(asked(8.0), FLAT, slipping, Motion(30.0))
    car.start()
    rolling = state.model_copy(update={f"wheel_speed_{wheel}": 30.0 for wheel in ("fl", "fr", "rl", "rr")})
    sent = car.step(asked(8.0), FLAT, rolling, Motion(30.0))
    assert (sent.brake_front, sent.brake_rear) == car.shared(asked(8.0), FLAT, 30.0)


def test_wheels_that_are_not_believed_let_nothing_go(rig):
    state, car = rig.gateway.seen[0], brakes()
    slow = state.model_copy(update={f"wheel_speed_{wheel}": 20.0 for wheel in ("fl", "fr", "rl", "rr")})
    sent = car.step(asked(8.0), FLAT, slow, Motion(30.0, by_wheels=False))
    assert (sent.brake_front, sent.brake_rear) == car.shared(asked(8.0), FLAT, 30.0)


def watched(rig: Rig, front: float, rear: float = 1.0) -> AxleBrakes:
    """Brakes whose circuits have reported such shares of their commands for half a second."""
    state, car, wire = rig.gateway.seen[0], brakes(), asked(8.0)
    reported = {"brake_front": front * wire.brake_front, "brake_rear": rear * wire.brake_rear}
    for _ in range(50):
        car.watch(state.model_copy(update=reported), wire)
    return car


def test_a_weak_circuit_is_asked_for_more_and_the_rear_tyres_count_with_all_their_grip(rig):
    state, sound, weak = rig.gateway.seen[0], watched(rig, 0.95), watched(rig, 0.3)
    usual, more = (car.step(asked(8.0), BEND, state, Motion(50.0, by_wheels=False)) for car in (sound, weak))
    assert usual == asked(8.0)
    assert more.brake_front == pytest.approx(
        min(weak.shared(asked(8.0), BEND, 50.0)[0] / 0.3, TRAIN.brake_pressure_max), rel=0.05
    )
    assert more.brake_rear > 1.2 * sound.shared(asked(8.0), BEND, 50.0)[1]


def test_a_circuit_that_is_late_is_not_weak(rig):
    state, car = rig.gateway.seen[0], brakes()
    for period in range(60):
        wire, before = asked(min(1.0 * period, 12.0)), asked(min(max(period - 7.0, 0.0), 12.0))
        late = {"brake_front": before.brake_front, "brake_rear": before.brake_rear}
        car.watch(state.model_copy(update=late), wire)
    sent = car.step(asked(8.0), STRAIGHT, state, Motion(50.0, by_wheels=False))
    assert sent == asked(8.0)


def test_front_tyres_that_brake_alone_keep_a_tenth_of_what_they_leave_beside_the_lateral_force(rig):
    dead, sound = watched(rig, 1.0, rear=0.0), brakes()
    alone, as_declared = (car.shared(asked(25.0), BEND, 30.0)[0] for car in (dead, sound))
    force = asked(25.0)
    moved = (force.brake_front + force.brake_rear) * TRAIN.brake_force_per_pa * VEHICLE.cg_height / VEHICLE.wheelbase
    pressed = -0.5 * VEHICLE.air_density * VEHICLE.lift_area_front * 30.0**2
    bears = GRIP * (VEHICLE.static_load_front + pressed + moved)
    across = 14.0 * VEHICLE.static_load_front / GRAVITY
    assert alone * TRAIN.brake_force_per_pa <= 0.901 * max((bears**2 - across**2), (LEAST_SHARE * bears) ** 2) ** 0.5
    assert alone < as_declared
