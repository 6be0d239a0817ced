"""Wheel, pedals and the dead man's switch: events as the kernel writes them, commands as the gateway takes them."""

from __future__ import annotations

import os
import struct

import pytest
from support.cars import car_messages

from hil_gateway.joystick.device import Controls, Device
from hil_gateway.joystick.node import Hands
from hil_gateway.process.errors import InputError
from hil_gateway.settings.joystick import JoystickConfig

RANGES = {"x": (-32768, 32767), "z": (0, 255), "rz": (0, 255)}
SWITCH = JoystickConfig().dead_man


def events(*rows: tuple[int, int, int]) -> bytes:
    """(type, code, value) as on a 64-bit machine."""
    return b"".join(struct.pack("=qqHHi", 0, 0, *row) for row in rows)


def pressed(controls: Controls) -> Controls:
    controls.take(events((3, 0, 0), (3, 2, 0), (3, 5, 0), (1, SWITCH, 1)))
    return controls


def test_axes_go_from_end_to_end_and_buttons_are_those_pressed():
    controls = Controls(RANGES)
    controls.take(events((3, 0, 32767), (3, 2, 255), (3, 5, 0), (3, 16, 1), (1, 310, 1), (1, 311, 1), (1, 311, 0)))
    assert controls.axes == {"x": 1.0, "z": 1.0, "rz": -1.0} and controls.pressed == {310}
    controls.take(events((3, 0, 99999)))
    assert controls.axes["x"] == 1.0


def test_where_events_were_lost_the_switch_has_to_be_pressed_again():
    controls, hands = pressed(Controls(RANGES)), Hands(JoystickConfig(), "joystick 1")
    state = car_messages.vehicle_state(10)
    assert hands.command(controls, state, 20) is not None
    controls.take(events((0, 3, 0)))
    assert hands.command(controls, state, 30) is None
    controls.take(events((1, SWITCH, 1)))
    assert hands.command(controls, state, 40) is not None


def test_commands_are_those_of_a_person():
    controls, hands = pressed(Controls(RANGES)), Hands(JoystickConfig(), "joystick 1")
    state = car_messages.vehicle_state(10)
    rest = hands.command(controls, state, 20)
    assert rest is not None and rest.drive == 0.0 and rest.steer == pytest.approx(0.0, abs=1e-5)
    assert (rest.source, rest.stamp_ns, rest.state_stamp_ns) == ("joystick 1", 20, 10)
    controls.take(events((3, 0, 32767), (3, 5, 255)))
    right = hands.command(controls, state, 30)
    assert right is not None and right.seq > rest.seq
    assert (right.steer, right.drive) == (-JoystickConfig().steer_full, JoystickConfig().drive_full)
    controls.take(events((3, 2, 255)))
    braked = hands.command(controls, state, 40)
    assert braked is not None and braked.drive == -JoystickConfig().brake_full, "the brake counts, not the accelerator"


def test_a_wheel_whose_pedals_fall_does_not_drive_off_and_one_that_has_not_moved_says_nothing():
    controls, hands = Controls(RANGES), Hands(JoystickConfig(pedals_fall=True), "joystick 1")
    state = car_messages.vehicle_state(10)
    controls.take(events((1, SWITCH, 1), (3, 0, 0)))
    assert hands.command(controls, state, 20) is None, "where the pedals are is not known before they move"
    controls.take(events((3, 2, 255), (3, 5, 255)))
    rest = hands.command(controls, state, 20)
    assert rest is not None and rest.drive == 0.0


def test_what_is_no_joystick_is_refused_by_name(tmp_path):
    with pytest.raises(InputError, match="No such file"):
        Device(tmp_path / "event7")
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with pytest.raises(InputError, match="it has no axis"):
        Device(pipe)
