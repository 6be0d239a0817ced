"""Fault model of the car: every sensor and actuator fault, by what it is noticed, in what time; and its simulation.

Sensor faults change the frames on their way to the gateway, actuator faults what the simulated car's actuators get;
the car reports truthfully what they then do.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from can_dbc.codec import Fault, load_codec
from hil_gateway.can_link import Frame
from hil_gateway.plant.car import Commands
from hil_gateway.process.clock import NS_PER_S
from planner.simulation.loop import Faults

Values = dict[str, float]
Alter = Callable[[Values, "Memory"], "Values | None"]
EARTH_M = 6.371e6
"""m per rad of latitude"""
IMU = ("imu_1", "imu_2", "imu_3")
WHEELS = ("wheel_speed_report",)
POSITION = ("novatel_report",)
STEERING = ("steering_report", "steering_report_extd")


@dataclass
class Memory:
    """What an alteration knows: time since the fault began (s), what it has kept, its own noise."""

    rng: random.Random
    t: float = 0.0
    kept: Values | None = None


@dataclass(frozen=True)
class CarFault:
    """One line of the fault model."""

    name: str
    messages: tuple[str, ...]
    """CAN messages it changes; none: an actuator"""
    noticed_by: tuple[str, ...]
    """rows of the failsafe table, any of which is right; none: harmless or not to be noticed, see `why`"""
    within_s: float
    """from its first effect on what the car does or says"""
    why: str
    """the independent signal"""
    alter: Alter | None = None
    delay_s: float = 0.0
    twice_m: float = 0.0
    """a second sender, so far beside, m"""
    actuate: Callable[[Commands, Commands], Commands] | None = None
    """(asked, asked when the fault began) to what the actuators do"""


def _lost(values: Values, memory: Memory) -> None:
    """Nothing arrives."""


def _frozen(values: Values, memory: Memory) -> Values:
    memory.kept = memory.kept or dict(values)
    return memory.kept


def _dithering(values: Values, memory: Memory) -> Values:
    return {name: value + memory.rng.gauss(0, 1e-2) for name, value in _frozen(values, memory).items()}


def _north(metres: Callable[[Memory], float]) -> Alter:
    def alter(values: Values, memory: Memory) -> Values:
        return values | {"novatel_lat": values["novatel_lat"] + metres(memory) / EARTH_M}

    return alter


def _scaled(factor: float, *names: str) -> Alter:
    return lambda values, memory: values | {name: factor * values[name] for name in names if name in values}


def _plus(offset: float, *names: str) -> Alter:
    return lambda values, memory: values | {name: values[name] + offset for name in names if name in values}


def _swapped(values: Values, memory: Memory) -> Values:
    return values | {
        "wheel_speed_FL": values["wheel_speed_FR"], "wheel_speed_FR": values["wheel_speed_FL"],
        "wheel_speed_RL": values["wheel_speed_RR"], "wheel_speed_RR": values["wheel_speed_RL"],
    }  # fmt: skip


INERTIAL = ("imu_ax", "imu_ay", "imu_yaw_rate")
ANGLES = ("primary_steering_angle_fbk", "secondary_steering_ang_fdbk", "average_steering_ang_fdbk")
_MOTION = (
    "yaw_rate_wrong",
    "acceleration_wrong",
    "commands_unanswered",
    "position_wrong",
    "estimate_invalid",
    "off_road",
)
_FIX = ("position_wrong", "estimate_invalid")

CAR_FAULTS: tuple[CarFault, ...] = (
    CarFault("position missing", POSITION, ("position_lost",), 1.1, "its age", _lost),
    CarFault("position repeats its last fix", POSITION, _FIX, 0.4, "way by wheels and gyro", _frozen),
    CarFault("position steps by 4 m", POSITION, _FIX, 0.4, "way by wheels and gyro", _north(lambda m: 4.0)),
    CarFault(
        "position ramps by 5 m/s",
        POSITION,
        (*_FIX, "off_road"),
        2.0,
        "way by wheels and gyro",
        _north(lambda m: 5 * m.t),
    ),
    CarFault(
        "position drifts by 0.5 m/s",
        POSITION,
        (),
        math.inf,
        "nothing on board is independent of one receiver over ten seconds: heading and wheel radius explain it",
        _north(lambda m: 0.5 * m.t),
    ),
    CarFault("position 0.1 s late", POSITION, _FIX, 0.6, "way by wheels and gyro, above 30 m/s", None, delay_s=0.1),
    CarFault("position 0.3 s late", POSITION, _FIX, 0.8, "way by wheels and gyro", None, delay_s=0.3),
    CarFault("position 0.5 s late", POSITION, _FIX, 1.0, "way by wheels and gyro", None, delay_s=0.5),
    CarFault(
        "position noisy by 1 m", POSITION, _FIX, 1.0, "way by wheels and gyro", _north(lambda m: m.rng.gauss(0, 1.0))
    ),
    CarFault(
        "second sender of positions", POSITION, (*_FIX, "sender_doubled"), 1.2, "frames a second", None, twice_m=3.0
    ),
    CarFault("IMU missing", IMU, ("state_invalid",), 0.15, "its age", _lost),
    CarFault("IMU frozen", IMU, ("state_invalid",), 0.35, "noise changes the last bit of every frame", _frozen),
    CarFault("IMU constant with dither", IMU, _MOTION, 6.0, "wheels and steering, in the next bend", _dithering),
    CarFault("IMU near zero", IMU, _MOTION, 6.0, "wheels and steering, in the next bend", _scaled(0.02, *INERTIAL)),
    CarFault("IMU sign flipped", IMU, _MOTION, 6.0, "wheels and steering, in the next bend", _scaled(-1.0, *INERTIAL)),
    CarFault(
        "yaw rate off by 0.3 rad/s", IMU, _MOTION, 1.5, "v r against lateral force; wheels", _plus(0.3, "imu_yaw_rate")
    ),
    CarFault("wheel speeds missing", WHEELS, ("state_invalid",), 0.15, "their age", _lost),
    CarFault("wheel speeds frozen", WHEELS, ("state_invalid",), 0.35, "noise changes the last bit", _frozen),
    CarFault(
        "one rear wheel speed zero",
        WHEELS,
        ("wheel_speed_wrong", "acceleration_wrong", "yaw_rate_wrong"),
        0.7,
        "the other three",
        _scaled(0.0, "wheel_speed_RL"),
    ),
    CarFault(
        "one front wheel speed at 70 %",
        WHEELS,
        ("wheel_speed_wrong", "acceleration_wrong", "yaw_rate_wrong"),
        1.0,
        "the other three",
        _scaled(0.7, "wheel_speed_FR"),
    ),
    CarFault(
        "wheel speeds at 80 %",
        WHEELS,
        (*_FIX, "off_road", "acceleration_wrong"),
        1.5,
        "way between fixes",
        _scaled(0.8, "wheel_speed_FL", "wheel_speed_FR", "wheel_speed_RL", "wheel_speed_RR"),
    ),
    CarFault(
        "wheel speeds left and right swapped",
        WHEELS,
        (),
        math.inf,
        "the mean of an axle stays right: harmless",
        _swapped,
    ),
    CarFault(
        "steering angle reported frozen",
        STEERING,
        ("steering_stuck", "state_invalid", "counters_wrong"),
        6.0,
        "its command",
        _frozen,
    ),
    CarFault(
        "steering angle off by 15 deg",
        STEERING,
        ("steering_stuck", "state_invalid"),
        0.6,
        "its command",
        _plus(math.radians(15), *ANGLES),
    ),
    CarFault(
        "steering stuck",
        (),
        ("steering_stuck", "off_road"),
        3.0,
        "its command, once it differs by 8 deg",
        actuate=lambda asked, then: replace(asked, steer=then.steer),
    ),
    CarFault(
        "brakes dead",
        (),
        ("commands_unanswered", "acceleration_wrong", "pedals_stuck", "off_road"),
        6.0,
        "deceleration, at the next braking",
        actuate=lambda asked, then: replace(asked, brake_front=0.0, brake_rear=0.0),
    ),
    CarFault(
        "throttle stuck at 60 %",
        (),
        ("commands_unanswered", "acceleration_wrong", "pedals_stuck", "off_road"),
        6.0,
        "acceleration, once closed",
        actuate=lambda asked, then: replace(asked, throttle=max(asked.throttle, 0.6)),
    ),
)


class SimulatedFault(Faults):
    """One fault from `begin` on; nothing before."""

    def __init__(self) -> None:
        self.fault: CarFault | None = None
        self._codec = load_codec()
        self._memory: dict[str, Memory] = {}
        self._held: list[tuple[int, Frame]] = []
        self._start_ns = 0
        self._rng = random.Random(0)

    def begin(self, fault: CarFault, now_ns: int, seed: int) -> None:
        """From now on."""
        self.fault, self._start_ns, self._rng = fault, now_ns, random.Random(seed)

    def break_actuators(self, plant: Any) -> None:
        """Put an actuator fault between the vehicle controller and the car."""
        fault = self.fault
        if fault is None or fault.actuate is None:
            return
        actuate, obeyed = fault.actuate, plant.controller.obeyed
        then: list[Commands] = []

        def broken(t_ns: int, received: Any) -> Commands:
            asked = obeyed(t_ns, received)
            then[:] = then or [asked]
            return actuate(asked, then[0])

        plant.controller.obeyed = broken

    def frames(self, now_ns: int, receiver: str, frames: list[Frame]) -> list[Frame]:
        if self.fault is None or receiver != "gateway":
            return frames
        out = [frame for due, frame in self._held if due <= now_ns]
        self._held = [entry for entry in self._held if entry[0] > now_ns]
        for frame in frames:
            out += self._through(self.fault, frame, now_ns)
        return out

    def _through(self, fault: CarFault, frame: Frame, now_ns: int) -> list[Frame]:
        layout = self._codec.by_id.get(frame.id)
        if layout is None or layout.name not in fault.messages:
            return [frame]
        if fault.delay_s:
            self._held.append((now_ns + int(fault.delay_s * NS_PER_S), frame))
            return []
        if fault.twice_m:
            other = self._altered(layout.name, frame, _north(lambda m: fault.twice_m), now_ns)
            return [frame, *other, *other]
        return [frame] if fault.alter is None else self._altered(layout.name, frame, fault.alter, now_ns)

    def _altered(self, name: str, frame: Frame, alter: Alter, now_ns: int) -> list[Frame]:
        memory = self._memory.setdefault(name, Memory(self._rng))
        memory.t = (now_ns - self._start_ns) / NS_PER_S
        values = self._codec.decode(frame.id, frame.data)
        changed = None if isinstance(values, Fault) else alter(values, memory)
        if changed is None or isinstance(values, Fault):
            return []
        counter = self._codec.by_id[frame.id].counter
        alive: Mapping[str, float] = {counter.signal: values[counter.signal]} if counter else {}
        return [replace(frame, data=self._codec.encode(name, {**changed, **alive})[1])]


def markdown() -> str:
    """The fault model for the documentation."""
    lines = ["| fault | noticed by | within | how |", "| --- | --- | --- | --- |"]
    for fault in CAR_FAULTS:
        within = f"{fault.within_s:g} s" if math.isfinite(fault.within_s) else "-"
        lines.append(f"| {fault.name} | {', '.join(fault.noticed_by) or 'nothing'} | {within} | {fault.why} |")
    return "\n".join(lines)
