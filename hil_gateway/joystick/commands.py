"""What a person asks for with wheel and pedals, as commands of the gateway. Pure."""

from __future__ import annotations

from hil_gateway.bus.messages import Command, VehicleState
from hil_gateway.joystick.device import Controls
from hil_gateway.settings.joystick import JoystickConfig


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
