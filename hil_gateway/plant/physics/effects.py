"""Switches of the simulated car: one size per effect, named as everywhere in the project.

An effect sets what the plant does beyond the declared model (Eq. 1-3). On the base `paper` everything not named
is off; on `av24` everything is on at its realistic size, and naming an effect changes that size.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from hil_gateway.plant.physics.parameters import AV24, BASES, PlantParameters
from hil_gateway.process.errors import InputError

Setter = Callable[[PlantParameters, float], PlantParameters]


@dataclass(frozen=True)
class Switch:
    """One effect: unit and meaning of its size, the range it may have, and what it sets."""

    unit: str
    meaning: str
    low: float
    high: float
    example: float
    """a size that is clearly visible in 8 laps, used by campaigns"""
    set: Setter
    brings: tuple[str, ...] = ()
    """effects without which this one shows nothing; they come at the realistic base's size where the base lacks them"""


def _car(**names: float) -> Setter:
    """Fields of the car set to size times the factors given."""

    def apply(p: PlantParameters, size: float) -> PlantParameters:
        changed: Any = {name: factor * size for name, factor in names.items()}
        return replace(p, car=replace(p.car, **changed))

    return apply


def _part(part: str, offset: float = 0.0, **names: float) -> Setter:
    """Fields of `road` or `sensors` set to offset + factor * size."""

    def apply(p: PlantParameters, size: float) -> PlantParameters:
        changed: Any = replace(getattr(p, part), **{name: offset + factor * size for name, factor in names.items()})
        return replace(p, **{part: changed})

    return apply


def _steer_scale(p: PlantParameters, size: float) -> PlantParameters:
    return replace(p, car=replace(p.car, steer_scale=1.0 + size))


def _steer_delay(p: PlantParameters, size: float) -> PlantParameters:
    return replace(p, steer_late=size, car=replace(p.car, steer_late=float(size > 0.0)))


def _drive_delay(p: PlantParameters, size: float) -> PlantParameters:
    return replace(p, drive_late=size, car=replace(p.car, drive_late=float(size > 0.0)))


_imu_bias = _part("sensors", imu_bias_x=1.0, imu_bias_y=1.0)
_speed_scale = _part("sensors", offset=1.0, speed_scale=1.0)

LOADS = ("aero_downforce", "load_transfer")
REALISTIC = {"aero_drag": AV24.car.drag, "aero_downforce": AV24.car.downforce, "load_transfer": AV24.car.load_transfer}

SWITCHES: dict[str, Switch] = {
    "aero_drag": Switch("N s2/m2", "k in F = k v^2 against the air", 0.0, 3.0, 0.6, _car(drag=1.0)),
    "rolling_resistance": Switch("N", "constant", 0.0, 3000.0, 300.0, _car(rolling_resistance=1.0)),
    "road_grade": Switch("1", "share of the track file's grade", -2.0, 2.0, 1.0, _part("road", grade=1.0)),
    "road_bank": Switch("1", "share of the track file's bank", -2.0, 2.0, 1.0, _part("road", bank=1.0)),
    "aero_downforce": Switch("N s2/m2", "k of both axles together", 0.0, 6.0, 1.5, _car(downforce=1.0)),
    "load_transfer": Switch("1", "share of the real transfer", 0.0, 3.0, 1.0, _car(load_transfer=1.0)),
    "load_sensitivity": Switch("1", "loss at twice the load", 0.0, 0.6, 0.25, _car(load_sensitivity=1.0), LOADS),
    "combined_slip": Switch("1", "0: none, 1: similarity method", 0.0, 1.0, 1.0, _car(combined_slip=1.0)),
    "drive_saturation": Switch("1", "0: linear in slip, 1: magic formula", 0.0, 1.0, 1.0, _car(saturation=1.0)),
    "front_brake": Switch("1", "share of the front circuit acting in front", 0.0, 1.0, 1.0, _car(front_brake=1.0)),
    "engine_braking": Switch("N", "at the wheels, throttle closed", 0.0, 3000.0, 600.0, _car(engine_drag=1.0)),
    "steer_offset": Switch("rad", "true minus reported road-wheel angle", -0.05, 0.05, 0.006, _car(steer_offset=1.0)),
    "steer_scale": Switch("1", "excess of true over reported angle", -0.3, 0.3, 0.06, _steer_scale),
    "steer_delay": Switch("s", "true angle behind the reported one", 0.0, 0.3, 0.06, _steer_delay),
    "drive_delay": Switch("s", "true torque and brakes behind the reported ones", 0.0, 0.5, 0.15, _drive_delay),
    "tyre_relaxation": Switch("m", "relaxation length of lateral slip", 0.0, 3.0, 0.9, _car(relaxation_y=1.0)),
    "grip_drift": Switch("1/s", "relative change of grip a second", -1e-3, 1e-3, 2e-4, _part("road", grip_drift=1.0)),
    "imu_misalignment": Switch("rad", "IMU turned about z", -0.2, 0.2, 0.03, _part("sensors", imu_yaw=1.0)),
    "imu_lever_arm": Switch("m", "IMU ahead of the centre of gravity", -3.0, 3.0, 0.8, _part("sensors", imu_x=1.0)),
    "imu_bias": Switch("m/s2", "added to ax and ay", -3.0, 3.0, 0.3, _imu_bias),
    "speed_scale": Switch("1", "excess of reported over true speed", -0.2, 0.2, 0.04, _speed_scale),
    "wind": Switch("m/s", "air along map x", -30.0, 30.0, 10.0, _car(wind_x=1.0), ("aero_drag",)),
    "yaw_damping": Switch("N m s", "moment against yaw", 0.0, 10000.0, 1500.0, _car(yaw_damping=1.0)),
    "turn_asymmetry": Switch("1", "gain of grip to the left", -0.3, 0.3, 0.06, _car(turn_asymmetry=1.0)),
}  # fmt: skip


def implied(name: str) -> tuple[str, ...]:
    """Effects that come with `name` on the base `paper`."""
    return SWITCHES[name].brings if name in SWITCHES else ()


def configure(base: str = "av24", effects: Mapping[str, float] | None = None) -> PlantParameters:
    """Parameters of the base with each named effect at its size.

    Raises:
        InputError: unknown base or effect (lists the known ones), or a size outside its range.
    """
    if base not in BASES:
        raise InputError(f"plant base {base!r} is unknown; known: {', '.join(BASES)}")
    parameters = BASES[base]
    sizes = dict(effects or {})
    if base == "paper":
        sizes = {**{n: REALISTIC[n] for name in sizes for n in implied(name)}, **sizes}
    for name, size in sizes.items():
        if name not in SWITCHES:
            raise InputError(f"effect {name!r} is unknown; known: {', '.join(SWITCHES)}")
        switch = SWITCHES[name]
        if not switch.low <= size <= switch.high:
            raise InputError(f"effect {name} = {size:g} is outside {switch.low:g} to {switch.high:g} {switch.unit}")
        parameters = switch.set(parameters, size)
    return parameters
