"""Newest frame of each message of the car, and whether it can be believed by itself."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from can_dbc.codec import Codec, Decoder, Values
from can_dbc.database import BusMessage
from can_dbc.quantities import WHEELS
from hil_gateway.car.car import Car
from hil_gateway.gateway.perceive.duration import UNSEEN_S
from hil_gateway.gateway.perceive.frame_counts import LeakyBucket
from hil_gateway.gateway.perceive.positions.fixes import MOVING, Fixes
from hil_gateway.gateway.perceive.road_speed import STANDSTILL
from hil_gateway.process.clock import NS_PER_S

STUCK_FRAMES = 20
"""So many IMU or wheel frames (0.2 s) with the very same bytes while moving: the sensor hangs (noise changes the last
bit of each; a sensor at 50 Hz repeats itself once). The mean noise of so many differs from the usual one by a fifth."""
OVER = 1.4
"""times its declared rate at which a message may come for ever: a sender's clock, and frames that waited somewhere"""
WHEEL_SPEEDS = tuple(f"wheel_speed_{wheel}" for wheel in WHEELS)
MOTOR_SENSORS = ("steering_motor_primary", "steering_motor_secondary")


@dataclass(slots=True)
class Received:
    """Newest frame of one message."""

    layout: BusMessage
    decode: Decoder
    limits: tuple[tuple[str, float, float], ...]
    """quantity and what the car can do, SI"""
    deadline_ns: int
    repeatable: bool
    """the same bytes again say the same again: no counter, no new fix, no sensor that may hang"""
    modulus: int
    """of its counter; 0: it does not count"""
    surplus: LeakyBucket
    """frames beyond those of one sender"""
    places: bool
    """whether it carries the position of the receiver that places the car"""
    checks: tuple[Check, ...] = ()
    stamp_ns: int | None = None
    data: bytes | None = None
    plausible: bool = False
    counter: int | None = None
    repeats: int = 0
    doubled: bool = False
    """whether more than one sender sends it, as of its newest frame"""

    def count(self, now_ns: int) -> None:
        """One frame more."""
        surplus = self.surplus
        surplus.add(now_ns)
        # it runs over at twice of what is too many
        self.doubled = surplus.empty_ns - now_ns > (surplus.highest // 2 - 1) * surplus.leak_ns


Check = Callable[[Received, Mapping[str, float]], bool]
"""whether a frame can be believed, by its quantities and those that came before"""


class Checks:
    """What is looked at beyond limits: sensors that hang, wheels that stand in a moving car, motor sensors apart."""

    def __init__(self, car: Car, newest: Mapping[str, float], fixes: Fixes) -> None:
        self._apart = car.sensors.steering_apart
        self._newest, self._fixes = newest, fixes

    def of(self, quantities: tuple[str, ...]) -> tuple[Check, ...]:
        """For a message that carries these."""
        found: list[Check] = []
        if any(name.startswith("imu.") for name in quantities):
            found.append(self._imu_is_live)
        if set(WHEEL_SPEEDS) & set(quantities):
            found.append(self._wheels_turn)
        if set(MOTOR_SENSORS) & set(quantities):
            found.append(self._motor_sensors_agree)
        return tuple(found)

    def _imu_is_live(self, entry: Received, values: Mapping[str, float]) -> bool:
        return entry.repeats < STUCK_FRAMES or self._newest["wheel_speed_rl"] < MOVING

    def _wheels_turn(self, entry: Received, values: Mapping[str, float]) -> bool:
        fastest = max([values[name] if name in values else self._newest[name] for name in WHEEL_SPEEDS])
        locked_or_dead = fastest < STANDSTILL and self._fixes.moving
        return not locked_or_dead and (entry.repeats < STUCK_FRAMES or fastest < MOVING)

    def _motor_sensors_agree(self, entry: Received, values: Mapping[str, float]) -> bool:
        primary, secondary = (self._value(name, values) for name in MOTOR_SENSORS)
        return abs(primary - secondary) <= self._apart

    def _value(self, name: str, values: Mapping[str, float]) -> float:
        """Of this frame, else the newest."""
        return values[name] if name in values else self._newest[name]


def received_messages(car: Car, newest: Values, fixes: Fixes) -> dict[int, Received]:
    """Identifier -> record, of every message of the car."""
    codec, checks = car.codec, Checks(car, newest, fixes)
    position = f"receiver.{next(iter(car.receivers))}.latitude"
    found = {}
    for layout in codec.messages.values():
        if layout.direction != "car":
            continue
        quantities = codec.quantities(layout.name)
        hangs = position in quantities or any(n.startswith("imu.") or n in WHEEL_SPEEDS for n in quantities)
        found[layout.id] = Received(
            layout=layout,
            decode=codec.quantity_decoders[layout.id],
            limits=_limits(codec, quantities),
            deadline_ns=round(layout.deadline_s * NS_PER_S),
            repeatable=layout.counter is None and not hangs,
            modulus=layout.counter.modulus if layout.counter is not None else 0,
            surplus=_surplus(layout.period_s),
            places=position in quantities,
            checks=checks.of(quantities),
        )
    return found


def _surplus(period_s: float) -> LeakyBucket:
    """Of frames with this period, half full of too many: more than any pause of one sender, beyond which a source has
    gone, delivers afterwards."""
    return LeakyBucket(round(period_s * NS_PER_S / OVER), highest=2 * max(round(UNSEEN_S / period_s), 5))


def _limits(codec: Codec, quantities: tuple[str, ...]) -> tuple[tuple[str, float, float], ...]:
    """What the car can do (`bus.toml`), SI."""
    places = ((name, codec.signals.reports[name].limits) for name in quantities)
    return tuple((name, *limits) for name, limits in places if limits is not None)
