"""Value and rate limits of the commands, on the raw integers that are packed into the frames.

Working on raw integers makes the promise exact: what is checked here is packed as it is (`Codec.pack`). Values
are the car's (`can_dbc/av24.toml`), rates the configuration's. Pure: the previous frame is an argument.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from can_dbc.codec import Codec
from can_dbc.database import Signal
from hil_gateway.car.actuation import Actuators
from hil_gateway.gateway.settings import PERIOD_S, LimitConfig

PEDAL_OVERLAP_PA = 50e3
"""Above this brake pressure the accelerator is closed."""


@dataclass(frozen=True, slots=True)
class RawCommand:
    """Raw integers of the actuator signals, as they stand in the frames."""

    steering_motor: int
    accelerator: int
    brake_front: int
    brake_rear: int
    gear: int


@dataclass(frozen=True, slots=True)
class SignalLimit:
    """Bounds of one raw signal; `rise` and `fall` are steps per frame."""

    name: str
    scale: float
    """SI per raw step"""
    low: int
    high: int
    rise: int
    fall: int

    def apply(self, wanted: float, previous: int) -> int:
        """Nearest admissible raw value to `wanted` (SI); not-a-number keeps the previous one."""
        low, high = max(self.low, previous - self.fall), min(self.high, previous + self.rise)
        raw = wanted / self.scale
        if math.isnan(raw):
            return min(max(previous, low), high)
        return low if raw <= low else high if raw >= high else round(raw)


class Limits:
    """All actuator limits; one call a frame."""

    def __init__(self, codec: Codec, config: LimitConfig) -> None:
        signals = {name: codec.messages[message].signal[name] for name, message in SIGNALS.items()}
        free = 1 << 16
        rates = {
            "steering_motor_ang_cmd": (config.steering_rate, config.steering_rate),
            "acc_pedal_cmd": (config.accelerator_rise, float("inf")),
            "F_brake_pressure_cmd": (config.brake_rise, config.brake_fall),
            "R_brake_pressure_cmd": (config.brake_rise, config.brake_fall),
            "desired_gear": (1 / PERIOD_S, 1 / PERIOD_S),
        }
        self.signals: Mapping[str, SignalLimit] = {
            name: _signal_limit(signal, *(_steps(rate, signal, free) for rate in rates[name]))
            for name, signal in signals.items()
        }
        self._overlap = round(PEDAL_OVERLAP_PA / self.signals["F_brake_pressure_cmd"].scale)

    def resting(self, steering_motor: float) -> RawCommand:
        """Where commands start from: pedals free, the steering (rad at the motor) where it is."""
        steering = self.signals["steering_motor_ang_cmd"]
        return RawCommand(min(max(round(steering_motor / steering.scale), steering.low), steering.high), 0, 0, 0, 1)

    def apply(self, wanted: Actuators, previous: RawCommand) -> tuple[RawCommand, tuple[str, ...]]:
        """Admissible command nearest to `wanted` after `previous`, and the names of the signals it had to change.

        The accelerator is closed while the brakes that are sent (not those asked for) still bite.
        """
        signals = self.signals
        front = signals["F_brake_pressure_cmd"].apply(wanted.brake_front, previous.brake_front)
        rear = signals["R_brake_pressure_cmd"].apply(wanted.brake_rear, previous.brake_rear)
        braking = max(front, rear) > self._overlap
        accelerator = 0.0 if braking or math.isnan(wanted.accelerator) else wanted.accelerator
        command = RawCommand(
            signals["steering_motor_ang_cmd"].apply(wanted.steering_motor, previous.steering_motor),
            signals["acc_pedal_cmd"].apply(accelerator, previous.accelerator),
            front,
            rear,
            signals["desired_gear"].apply(wanted.gear, previous.gear),
        )
        return command, self._changed(wanted, command)

    def to_actuators(self, command: RawCommand) -> Actuators:
        """SI values of what stands in the frames."""
        signals = self.signals
        return Actuators(
            command.steering_motor * signals["steering_motor_ang_cmd"].scale,
            command.accelerator * signals["acc_pedal_cmd"].scale,
            command.brake_front * signals["F_brake_pressure_cmd"].scale,
            command.brake_rear * signals["R_brake_pressure_cmd"].scale,
            command.gear,
        )

    def _changed(self, wanted: Actuators, command: RawCommand) -> tuple[str, ...]:
        sent = self.to_actuators(command)
        pairs = zip(self.signals.values(), _values(wanted), _values(sent), strict=True)
        return tuple(limit.name for limit, want, got in pairs if not abs(want - got) <= 0.501 * limit.scale)


SIGNALS: Mapping[str, str] = {
    "steering_motor_ang_cmd": "steering_cmd",
    "acc_pedal_cmd": "accelerator_cmd",
    "F_brake_pressure_cmd": "brake_pressure_cmd",
    "R_brake_pressure_cmd": "brake_pressure_cmd",
    "desired_gear": "gear_shift_cmd",
}
"""Actuator signal -> its message, in the order of `Actuators`."""


def _values(actuators: Actuators) -> tuple[float, ...]:
    return (
        actuators.steering_motor,
        actuators.accelerator,
        actuators.brake_front,
        actuators.brake_rear,
        actuators.gear,
    )


def _signal_limit(signal: Signal, rise: int, fall: int) -> SignalLimit:
    """Raw bounds inside the car's limits: the limit itself may lie between two raw steps."""
    if signal.limits is None:
        raise ValueError(f"{signal.name}: no limits in av24.toml")
    low, high = signal.limits
    raw_low, raw_high = signal.raw_range
    return SignalLimit(
        signal.name,
        signal.si_resolution,
        max(math.ceil(low / signal.scale - 1e-9), raw_low),
        min(math.floor(high / signal.scale + 1e-9), raw_high),
        rise,
        fall,
    )


def _steps(rate: float, signal: Signal, free: int) -> int:
    """Steps per frame of a rate in DBC units per second."""
    return free if math.isinf(rate) else math.floor(rate * PERIOD_S / signal.scale + 1e-9)
