"""Fault model of the car: every fault of sensors, actuators, power and bus, by what it is noticed, in what time."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from can_dbc.codec import load_codec
from hil_gateway.plant.car import Commands

Values = dict[str, float]
Alter = Callable[[Values, "Memory"], "Values | None"]
SLOW_RAD = 5e-4
"""a period: 3 deg/s at the road wheel, an eighth of what the motor does"""
EARTH_M = 6.371e6
"""m per rad of latitude"""
IMU = ("imu_1", "imu_2", "imu_3")
WHEELS = ("wheel_speed_report",)
POSITION = ("novatel_report",)
STEERING = ("steering_report", "steering_report_extd")
MISC = ("misc_report",)
DRIVE_BY_WIRE = (*STEERING, *MISC, "brake_pressure_report", "accelerator_report", "pt_report_1", "diagnostic_report")
EVERYTHING = tuple(name for name, layout in load_codec().messages.items() if layout.direction == "car")


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
    """CAN messages it changes; none: an actuator, or a tyre"""
    noticed_by: tuple[str, ...]
    """rows of the failsafe table, any of which is right; none: harmless or not to be noticed, see `why`"""
    within_s: float
    """from its first effect on what the car does or says"""
    why: str
    """the independent signal"""
    alter: Alter | None = None
    delay_s: float = 0.0
    twice: Alter | None = None
    """a second sender at double rate, which says this"""
    actuate: Callable[[Commands, Commands], Commands] | None = None
    """(asked, what they did in the period before) to what the actuators do, once in 10 ms"""
    flat: Literal["", "fl", "fr", "rl", "rr"] = ""
    """a tyre that loses its air"""


def _lost(values: Values, memory: Memory) -> None:
    """Nothing arrives."""


def _frozen(values: Values, memory: Memory) -> Values:
    memory.kept = memory.kept or dict(values)
    return memory.kept


def _dithering(values: Values, memory: Memory) -> Values:
    return {name: value + memory.rng.gauss(0, 1e-2) for name, value in _frozen(values, memory).items()}


def north(metres: Callable[[Memory], float]) -> Alter:
    """A fix that is so far north of where the car is."""

    def alter(values: Values, memory: Memory) -> Values:
        return values | {"novatel_lat": values["novatel_lat"] + metres(memory) / EARTH_M}

    return alter


def scaled(factor: float, *names: str) -> Alter:
    """Signals times a factor."""
    return lambda values, memory: values | {name: factor * values[name] for name in names if name in values}


def plus(offset: float, *names: str) -> Alter:
    """Signals off by so much, in their SI units."""
    return lambda values, memory: values | {name: values[name] + offset for name in names if name in values}


def _falling(values: Values, memory: Memory) -> Values:
    return values | {"battery_voltage": values["battery_voltage"] - 0.5 * memory.t}


def _turned_map(values: Values, memory: Memory) -> Values:
    return values | {"novatel_lat": values["novatel_long"], "novatel_long": values["novatel_lat"]}


def _axles_swapped(values: Values, memory: Memory) -> Values:
    return values | {
        "wheel_speed_FL": values["wheel_speed_RL"], "wheel_speed_RL": values["wheel_speed_FL"],
        "wheel_speed_FR": values["wheel_speed_RR"], "wheel_speed_RR": values["wheel_speed_FR"],
    }  # fmt: skip


def _slow_steering(asked: Commands, before: Commands) -> Commands:
    step = min(max(asked.steer - before.steer, -SLOW_RAD), SLOW_RAD)
    return asked._replace(steer=before.steer + step)


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
_FLAT = ("tyre_flat", "wheel_speed_wrong", "off_road")

CAR_FAULTS: tuple[CarFault, ...] = (
    CarFault("position missing", POSITION, ("position_lost",), 1.1, "its age", _lost),
    CarFault("position repeats its last fix", POSITION, _FIX, 0.4, "way by wheels and gyro", _frozen),
    CarFault("position steps by 4 m", POSITION, _FIX, 0.4, "way by wheels and gyro", north(lambda m: 4.0)),
    CarFault(
        "position ramps by 5 m/s",
        POSITION,
        (*_FIX, "off_road"),
        2.0,
        "way by wheels and gyro",
        north(lambda m: 5 * m.t),
    ),
    CarFault(
        "position drifts by 0.5 m/s",
        POSITION,
        (*_FIX, "off_road"),
        3.0,
        "two other receivers (`marelli_gps_*`, MyLaps), whose offsets and lateness are learnt",
        north(lambda m: 0.5 * m.t),
    ),
    CarFault("position 0.1 s late", POSITION, _FIX, 0.6, "way by wheels and gyro, above 30 m/s", None, delay_s=0.1),
    CarFault("position 0.3 s late", POSITION, _FIX, 0.8, "way by wheels and gyro", None, delay_s=0.3),
    CarFault("position 0.5 s late", POSITION, _FIX, 1.0, "way by wheels and gyro", None, delay_s=0.5),
    CarFault(
        "position noisy by 1 m", POSITION, _FIX, 4.0, "way by wheels and gyro, scatter across it",
        north(lambda m: m.rng.gauss(0, 1.0))
    ),
    CarFault(
        "second sender of positions", POSITION, (*_FIX, "sender_doubled"), 1.2, "frames a second",
        twice=north(lambda m: 3.0)
    ),
    CarFault("IMU missing", IMU, ("state_invalid",), 0.15, "its age", _lost),
    CarFault("IMU frozen", IMU, ("state_invalid",), 0.35, "noise changes the last bit of every frame", _frozen),
    CarFault(
        "IMU constant with dither", IMU, _MOTION, 6.0, "its own noise; steering, wheels, pedals, when they move",
        _dithering
    ),
    CarFault("IMU near zero", IMU, _MOTION, 6.0, "a step; its own noise", scaled(0.02, *INERTIAL)),
    CarFault(
        "IMU sign flipped", IMU, _MOTION, 6.0,
        "a step; steering and wheels in the next bend, or engine, brakes and wheels",
        scaled(-1.0, *INERTIAL)
    ),
    CarFault(
        "yaw rate off by 0.3 rad/s", IMU, _MOTION, 1.5, "a step; steering and wheels", plus(0.3, "imu_yaw_rate")
    ),
    CarFault("wheel speeds missing", WHEELS, ("state_invalid",), 0.15, "their age", _lost),
    CarFault("wheel speeds frozen", WHEELS, ("state_invalid",), 0.35, "noise changes the last bit", _frozen),
    CarFault(
        "one rear wheel speed zero",
        WHEELS,
        ("wheel_speed_wrong", "acceleration_wrong", "yaw_rate_wrong"),
        0.7,
        "the other three",
        scaled(0.0, "wheel_speed_RL"),
    ),
    CarFault(
        "one front wheel speed at 70 %",
        WHEELS,
        ("wheel_speed_wrong", "acceleration_wrong", "yaw_rate_wrong"),
        1.0,
        "the other three",
        scaled(0.7, "wheel_speed_FR"),
    ),
    CarFault(
        "wheel speeds at 80 %",
        WHEELS,
        (*_FIX, "off_road", "acceleration_wrong", "wheel_speed_wrong"),
        1.5,
        "way between fixes, change of speed by the IMU",
        scaled(0.8, "wheel_speed_FL", "wheel_speed_FR", "wheel_speed_RL", "wheel_speed_RR"),
    ),
    CarFault(
        "wheel speeds left and right swapped", WHEELS, (), math.inf, "the mean of an axle stays right: harmless",
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
        plus(math.radians(15), *ANGLES),
    ),
    CarFault(
        "steering stuck",
        (),
        ("steering_stuck", "off_road"),
        3.0,
        "its command, once it differs by 8 deg, or has moved by 3 while the steering stood still",
        actuate=lambda asked, before: asked._replace(steer=before.steer),
    ),
    CarFault(
        "brakes dead",
        (),
        ("commands_unanswered", "acceleration_wrong", "pedals_stuck", "off_road"),
        6.0,
        "deceleration, at the next braking",
        actuate=lambda asked, before: asked._replace(brake_front=0.0, brake_rear=0.0),
    ),
    CarFault(
        "throttle stuck at 60 %",
        (),
        ("commands_unanswered", "acceleration_wrong", "pedals_stuck", "off_road"),
        6.0,
        "acceleration, once closed",
        actuate=lambda asked, before: asked._replace(throttle=max(asked.throttle, 0.6)),
    ),
    CarFault(
        "IMU turned by 180 deg", IMU, _MOTION, 6.0,
        "a step; steering and wheels in the next bend, or engine, brakes and wheels",
        scaled(-1.0, "imu_ax", "imu_ay"),
    ),
    CarFault(
        "latitude and longitude swapped", POSITION, ("position_lost", *_FIX), 1.1, "no place of the map", _turned_map
    ),
    CarFault(
        "wheel speeds front and rear swapped", WHEELS, ("wheel_speed_wrong", *_MOTION), 6.0,
        "the other axle in a bend, engine and brakes; often not at all", _axles_swapped,
    ),
    CarFault(
        "second sender of wheel speeds", WHEELS, ("sender_doubled", "wheel_speed_wrong", *_MOTION, "state_invalid"),
        1.2, "frames a second",
        twice=scaled(0.9, "wheel_speed_FL", "wheel_speed_FR", "wheel_speed_RL", "wheel_speed_RR"),
    ),
    CarFault(
        "steering angle sign flipped", STEERING, ("steering_stuck", "state_invalid"), 6.0,
        "its command, once it is 4 deg",
        scaled(-1.0, *ANGLES),
    ),
    CarFault(
        "steering reversed", (), ("steering_stuck", "off_road"), 3.0,
        "its command, once it is 4 deg; where the yaw rate confirms it the stop steers to the other side",
        actuate=lambda asked, before: asked._replace(steer=-asked.steer),
    ),
    CarFault(
        "steering slow", (), ("steering_stuck", "off_road", "yaw_rate_wrong"), 6.0, "its command, once it is late",
        actuate=_slow_steering,
    ),
    CarFault(
        "front brakes at 30 %", (), ("pedals_stuck", "commands_unanswered"), 6.0, "their command, at the next braking",
        actuate=lambda asked, before: asked._replace(brake_front=0.3 * asked.brake_front),
    ),
    CarFault(
        "rear brakes dead", (), ("pedals_stuck", "commands_unanswered"), 6.0, "their command, at the next braking",
        actuate=lambda asked, before: asked._replace(brake_rear=0.0),
    ),
    CarFault(
        "battery at 10.5 V", MISC, ("supply_low",), 1.2, "its voltage", lambda v, m: v | {"battery_voltage": 10.5}
    ),
    CarFault("alternator dead, the battery falls by 0.5 V/s", MISC, ("supply_low",), 6.0, "its voltage", _falling),
    CarFault(
        "engine stalled", ("pt_report_1",), ("engine_stalled",), 0.5, "engine speed",
        lambda values, memory: values | {"engine_speed": 0.0},
        actuate=lambda asked, before: asked._replace(throttle=0.0),
    ),
    CarFault(
        "drive-by-wire disabled", (), ("steering_stuck", "pedals_stuck", "commands_unanswered", "off_road"), 6.0,
        "steering and pedals against their commands",
        actuate=lambda asked, before: asked._replace(steer=before.steer, throttle=0.0, brake_front=0.0, brake_rear=0.0),
    ),
    CarFault(
        "nothing arrives from the bus", EVERYTHING, ("can_silent",), 0.2, "silence; the stop goes by its own commands",
        _lost,
    ),
    CarFault("drive-by-wire node silent", DRIVE_BY_WIRE, ("state_invalid",), 0.2, "age of its reports", _lost),
    CarFault(
        "every frame 0.1 s late", EVERYTHING, ("can_silent",), 0.2,
        "silence, while they wait; then their counters tell how late they are", delay_s=0.1
    ),
    CarFault("front left tyre flat", (), _FLAT, 0.6, "its pressure", flat="fl"),
    CarFault("rear right tyre flat", (), _FLAT, 0.6, "its pressure", flat="rr"),
    CarFault(
        "IMU 0.3 s late", IMU, ("state_invalid",), 0.15, "silence, while it waits; not used again in this stop",
        delay_s=0.3
    ),
    CarFault(
        "left wheel speeds at 80 %", WHEELS, ("wheel_speed_wrong", *_MOTION), 6.0,
        "the right ones, gyro and lateral force, once the brakes are off",
        scaled(0.8, "wheel_speed_FL", "wheel_speed_RL"),
    ),
)  # fmt: skip


def listing() -> str:
    """The fault model for people: each fault, the rows that may notice it, in what time, and by what."""
    lines = []
    for fault in CAR_FAULTS:
        within = f"{fault.within_s:g} s" if math.isfinite(fault.within_s) else "-"
        lines.append(f"{fault.name}: {', '.join(fault.noticed_by) or 'nothing'}; {within}; {fault.why}")
    return "\n".join(lines)


if __name__ == "__main__":
    print(listing())
