"""Joystick process: commands of a person at 100 Hz while the dead man's switch is held."""

from __future__ import annotations

import logging
import os
from pathlib import Path

from hil_gateway.bus import topics
from hil_gateway.bus.interface import LatestReader
from hil_gateway.bus.messages import Command, VehicleState
from hil_gateway.bus.zenoh_bus import open_bus
from hil_gateway.config import Config
from hil_gateway.joystick.device import Controls, Device
from hil_gateway.process.clock import SystemClock
from hil_gateway.process.errors import InputError
from hil_gateway.process.lifecycle import StopRequest
from hil_gateway.process.scheduling import punctual
from hil_gateway.settings.joystick import JoystickConfig

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


class Hands:
    """Commands while the dead man's switch is held, and none else."""

    def __init__(self, config: JoystickConfig, source: str) -> None:
        self._config, self._source, self._seq = config, source, 0

    def command(self, controls: Controls, state: VehicleState, now_ns: int) -> Command | None:
        """None while the switch is not held, or while an axis of the configuration has never moved."""
        config = self._config
        needed = (config.steer_axis, config.drive_axis, config.brake_axis)
        if config.dead_man not in controls.pressed or any(name not in controls.axes for name in needed):
            return None
        steer, gas, brake = (controls.axes[name] for name in needed)
        self._seq += 1
        braked = self._pedal(brake) * config.brake_full
        return Command(
            stamp_ns=now_ns, seq=self._seq, source=self._source, state_stamp_ns=state.stamp_ns,
            steer=-steer * config.steer_full,  # an axis grows to the right
            drive=-braked if braked > 0.0 else self._pedal(gas) * config.drive_full,
        )  # fmt: skip

    def _pedal(self, position: float) -> float:
        """0 to 1 of a pedal that rests at one end of its axis."""
        return 0.5 * (1.0 - position if self._config.pedals_fall else 1.0 + position)
