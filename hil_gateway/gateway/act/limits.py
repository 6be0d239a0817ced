"""Value and rate limits of the commands, on the raw integers that are packed into the frames.

Working on raw integers makes the promise exact: what is checked here is packed as it is (`Codec.pack`). Values are the
car's, rates those of the configuration within the car's. Pure: the previous frame is an argument.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from can_dbc.signals import Place
from hil_gateway.car.actuation import PRESSED, ActuatorPositions
from hil_gateway.car.car import Car
from hil_gateway.process.errors import InputError
from hil_gateway.settings.gateway import CommandRates


class RawCommand(NamedTuple):
    """Raw integers of the actuator signals, as they stand in the frames; 0 where the car has no such signal."""

    steering_motor: int
    accelerator: int
    brake_front: int
    brake_rear: int
    gear: int

    def with_those_of(self, other: RawCommand, names: Iterable[str]) -> RawCommand:
        """The same with some of another command."""
        changed: dict[str, Any] = {name: getattr(other, name) for name in names}
        return self._replace(**changed)


@dataclass(frozen=True, slots=True)
class SignalLimit:
    """Bounds of one raw signal; `up` and `down` are steps per frame. By itself: of one that the car does not have."""

    name: str = ""
    scale: float = 1.0
    """SI per raw step; negative where the signal counts the other way"""
    zero: float = 0.0
    """SI at raw 0"""
    low: int = 0
    high: int = 0
    up: int = 0
    down: int = 0

    def apply(self, wanted: float, previous: int) -> int:
        """Nearest admissible raw value to `wanted` (SI); not-a-number keeps the previous one."""
        low, high = max(self.low, previous - self.down), min(self.high, previous + self.up)
        raw = (wanted - self.zero) / self.scale
        if math.isnan(raw):
            return min(max(previous, low), high)
        return low if raw <= low else high if raw >= high else round(raw)

    def nearest(self, wanted: float) -> int:
        """The same after anything."""
        return min(max(round((wanted - self.zero) / self.scale), self.low), self.high)

    def value(self, raw: int) -> float:
        """SI of a raw value."""
        return raw * self.scale + self.zero


class Limits:
    """All actuator limits; one call a frame."""

    def __init__(self, car: Car, rates: CommandRates) -> None:
        """
        Raises:
            InputError: a range or rate that the signal cannot show.
        """
        train, steering = car.powertrain, car.actuators.steering_range * car.vehicle.steering_ratio
        commands = car.codec.signals.commands
        ranges = {
            "steering_motor": (-steering, steering),
            "accelerator": (0.0, 1.0),
            "brake_front": (0.0, train.brake_pressure_max),
            "brake_rear": (0.0, train.brake_pressure_max),
            "gear": (0.0, float(len(train.gears))),
        }
        moves = {
            "steering_motor": (rates.steering, rates.steering),
            "accelerator": (rates.accelerator_rise, math.inf),
            "brake_front": (rates.brake_rise, rates.brake_fall),
            "brake_rear": (rates.brake_rise, rates.brake_fall),
            "gear": (1.0 / commands["gear"].message.period_s,) * 2,  # one gear a frame
        }
        self.signals: Mapping[str, SignalLimit] = {
            name: _signal_limit(name, commands[name], ranges[name], moves[name]) for name in ranges if name in commands
        }
        self._in_order = tuple(self.signals.get(name, SignalLimit()) for name in RawCommand._fields)
        self._bias = None if "brake_rear" in commands else train.brake_bias_front
        """front share of the pressure where the car sets the rear one by itself"""

    def resting(self, steering_motor: float) -> RawCommand:
        """Where commands start from: pedals free, the steering (rad at the motor) where it is."""
        rest = ActuatorPositions(steering_motor, 0.0, 0.0, 0.0, 1)
        return RawCommand(*map(SignalLimit.nearest, self._in_order, rest))

    def apply(self, wanted: ActuatorPositions, previous: RawCommand) -> tuple[RawCommand, tuple[str, ...]]:
        """Admissible command nearest to `wanted` after `previous`, and the names of the quantities it had to change.

        The accelerator is closed while the brakes that are sent (not those asked for) still bite.
        """
        asked = self._in_one_circuit(wanted)
        command = RawCommand(*map(SignalLimit.apply, self._in_order, asked, previous))
        sent = self.to_actuators(command)
        if max(sent.brake_front, sent.brake_rear) > 0.5 * PRESSED or math.isnan(asked.accelerator):
            closed = self.signals["accelerator"].apply(0.0, previous.accelerator)
            command = command._replace(accelerator=closed)
        return command, self._changed(asked, command)

    def to_actuators(self, command: RawCommand) -> ActuatorPositions:
        """SI values of what stands in the frames."""
        steering, accelerator, front, rear, gear = map(SignalLimit.value, self._in_order, command)
        rear = rear if self._bias is None else front * (1.0 - self._bias) / self._bias
        return ActuatorPositions(steering, accelerator, front, rear, round(gear))

    def _in_one_circuit(self, wanted: ActuatorPositions) -> ActuatorPositions:
        """What to ask of the front circuit where the rear one follows it: the same force of both together."""
        if self._bias is None:
            return wanted
        return wanted._replace(brake_front=self._bias * (wanted.brake_front + wanted.brake_rear), brake_rear=0.0)

    def _changed(self, wanted: ActuatorPositions, command: RawCommand) -> tuple[str, ...]:
        rows = zip(self._in_order, wanted, command, strict=True)
        return tuple(of.name for of, asked, raw in rows if not abs(asked - of.value(raw)) <= 0.501 * abs(of.scale))


def _signal_limit(name: str, place: Place, bounds: tuple[float, float], rates: tuple[float, float]) -> SignalLimit:
    """Raw bounds inside the car's limits: the limit itself may lie between two raw steps."""
    ends = sorted((bound - place.zero) / place.scale for bound in bounds)
    raw_low, raw_high = place.signal.raw_range
    low, high = max(math.ceil(ends[0] - 1e-9), raw_low), min(math.floor(ends[1] + 1e-9), raw_high)
    rise, fall = (_steps(rate, place, high - low) for rate in rates)
    if low >= high or min(rise, fall) < 1:
        raise InputError(
            f"{place.message.name}.{place.signal.name}: steps of {abs(place.scale):g} (SI) cannot show {name} from"
            f" {bounds[0]:g} to {bounds[1]:g} at {min(rates):g} 1/s in frames every {place.message.period_s:g} s"
        )
    up, down = (rise, fall) if place.scale > 0 else (fall, rise)
    return SignalLimit(name, place.scale, place.zero, low, high, up, down)


def _steps(rate: float, place: Place, most: int) -> int:
    """Steps per frame of a rate in SI per second; `most` are the whole range."""
    return math.floor(min(rate * place.message.period_s / abs(place.scale), most) + 1e-9)
