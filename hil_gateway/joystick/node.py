"""Joystick process: commands of a person at 100 Hz while the dead man's switch is held."""

from __future__ import annotations

import logging
import os
from pathlib import Path

from hil_gateway.bus import topics
from hil_gateway.bus.interface import LatestReader
from hil_gateway.bus.zenoh_bus import open_bus
from hil_gateway.config import Config
from hil_gateway.joystick.commands import Hands
from hil_gateway.joystick.device import Device
from hil_gateway.process.clock import SystemClock
from hil_gateway.process.errors import InputError
from hil_gateway.process.lifecycle import StopRequest
from hil_gateway.process.scheduling import punctual

log = logging.getLogger(__name__)


def run(config: Config, path: Path) -> None:
    """Run until SIGINT or SIGTERM.

    Raises:
        InputError: `path` is no joystick, it lacks an axis of the configuration, or it is pulled out.
    """
    device, stopped, clock = Device(path), StopRequest(), SystemClock()
    wanted = (config.joystick.steer_axis, config.joystick.drive_axis, config.joystick.brake_axis)
    if missing := [axis for axis in wanted if axis not in device.state.ranges]:
        raise InputError(f"{path}: no axis {missing[0]}; it has {', '.join(device.state.ranges)} (joystick.*_axis)")
    bus = open_bus(config.zenoh, "joystick")
    states, hands = LatestReader(bus, topics.VEHICLE_STATE), Hands(config.joystick, f"joystick {os.getpid()}")
    punctual("joystick")
    try:
        while not stopped():
            now_ns = clock.now_ns()
            if not device.read():
                raise InputError(f"{path}: pulled out; the gateway stops the car if it was driven by hand")
            state = states.update(now_ns)
            if state.message is not None and state.alive(now_ns):
                command = hands.command(device.state, state.message, now_ns)
                if command is not None:
                    bus.publish(topics.JOYSTICK_COMMAND, command)
            clock.sleep_until(now_ns + topics.JOYSTICK_COMMAND.period_ns)
    finally:
        bus.close()
        device.close()
