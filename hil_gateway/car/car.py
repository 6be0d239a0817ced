"""The car that is operated: one frozen, typed description, read once from its folder (docs/car-folder.md)."""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Mapping
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeVar

from pydantic import Field

from can_dbc.codec import Codec, load_codec
from can_dbc.errors import PlatformError
from can_dbc.folder import DEFAULT_PLATFORM, FILES, dbc_path, platform_folder, read_text, read_toml
from hil_gateway.car.figures import Angle, Figure, Force, In, Length, Number, Seconds, read_section
from hil_gateway.car.powertrain import Powertrain
from hil_gateway.car.vehicle import GRAVITY, Vehicle
from hil_gateway.process.errors import InputError
from hil_gateway.process.model import Model


class Actuators(Model):
    """What steering, pedals and brakes can do, SI."""

    steering_range: Angle = Field(gt=0.02, lt=1.0, description="road wheel, either side")
    steering_rate: Annotated[float, In("rad/s")] = Field(gt=0, description="of the motor")
    steering_delay: Seconds = Field(ge=0, le=0.5)
    steering_bandwidth: Annotated[float, In("Hz")] = Field(gt=0)
    angle_delay: Seconds = Field(ge=0, le=0.3, description="road wheel after the reported angle")
    accelerator_rise: Annotated[float, In("1/s")] = Field(gt=0, le=10.0)
    brake_rise: Annotated[float, In("Pa/s")] = Field(gt=0)
    brake_fall: Annotated[float, In("Pa/s")] = Field(gt=0)
    brake_delay: Seconds = Field(ge=0, le=0.5)
    brake_bandwidth: Annotated[float, In("Hz")] = Field(gt=0)
    force_delay: Seconds = Field(ge=0, le=0.3, description="force after reported pedal and pressure")
    speed_max: Annotated[float, In("m/s")] = Field(ge=5, le=150, description="fastest that is planned")
    supply_voltage_min: Annotated[float | None, In("V")] = Field(
        default=None, ge=0, description="least with which steering and brakes work for a stop; not given: not judged"
    )

    @property
    def steering_late(self) -> float:
        """From a command until the steering is there, s: delay, and time constant of the motor's control."""
        return self.steering_delay + 1.0 / (2.0 * math.pi * self.steering_bandwidth)

    @property
    def brakes_late(self) -> float:
        """The same of the brakes."""
        return self.brake_delay + 1.0 / (2.0 * math.pi * self.brake_bandwidth)

    @property
    def first_motion(self) -> float:
        """From a command to the first motion of the later of steering and brakes, s."""
        return max(self.steering_delay, self.brake_delay)


class TyrePrior(Model):
    """Prior of Eq. (2) for both layouts, and what is known beyond it."""

    cx: Force = Field(gt=0)
    b: Number = Field(gt=0)
    c: Number = Field(gt=0)
    d: Number = Field(gt=0)
    bf: Number = Field(gt=0)
    cf: Number = Field(gt=0)
    df: Number = Field(gt=0)
    br: Number = Field(gt=0)
    cr: Number = Field(gt=0)
    dr: Number = Field(gt=0)
    grip: Number = Field(ge=0.3, le=4, description="friction that a stop counts on")
    load_sensitivity: Number = Field(ge=0, lt=0.5, description="friction lost when the load doubles")
    combined_slip: Number = Field(gt=0, le=1.5, description="lateral over longitudinal friction of the ellipse")


class Sensors(Model):
    """Standard deviations of what the car reports of itself, SI."""

    wheel_speed_noise: Annotated[float, In("m/s")] = Field(gt=0)
    steering_noise: Angle = Field(gt=0, description="at the motor")
    steering_offset: Angle = Field(description="reported minus true angle, at the motor")
    steering_apart: Angle = Field(gt=0, description="by which the motor's two sensors may differ")


class Imu(Model):
    """One inertial sensor: place from the centre of gravity, turn, noise, delay; SI."""

    x: Length = Field(ge=-10, le=10, description="ahead")
    y: Length = Field(ge=-5, le=5, description="to the left")
    yaw: Angle = Field(ge=-3.2, le=3.2, description="turned to the left")
    rate_noise: Annotated[float, In("rad/s")] = Field(gt=0)
    rate_offset: Annotated[float, In("rad/s")]
    acceleration_noise: Annotated[float, In("m/s2")] = Field(gt=0)
    acceleration_offset: Annotated[float, In("m/s2")]
    delay: Seconds = Field(ge=0, le=0.5)


class Receiver(Model):
    """One satellite receiver: place from the centre of gravity, noise, error that wanders, delay; SI."""

    x: Length = Field(ge=-10, le=10)
    y: Length = Field(ge=-5, le=5)
    noise: Length = Field(gt=0)
    wander: Length = Field(ge=0, description="standard deviation of an error that changes slowly")
    wander_time: Seconds = Field(gt=0, description="its time constant")
    delay: Seconds = Field(ge=0, le=2, description="until its reading arrives")
    yaw: Angle = Field(default=0.0, ge=-3.2, le=3.2, description="heading of two antennas, turned to the left of ahead")


class TurnIn(NamedTuple):
    """How soon the yaw rate follows the steering angle: after v / (rest + per_speed2 v^2) seconds at the speed v."""

    rest: float
    """m/s2 at rest"""
    per_speed2: float
    """1/m, by downforce"""

    def follows(self, dt: float, speed: float) -> float:
        """Share of a change that it has followed after `dt` (s) at `speed` (m/s)."""
        return dt / (dt + speed / (self.rest + self.per_speed2 * speed**2) + 1e-9)


class Car(Model):
    """Everything that is known of the car before it has driven."""

    name: str
    platform: str
    """as it was asked for: the name of a shipped car, or a folder"""
    vehicle: Vehicle
    powertrain: Powertrain
    actuators: Actuators
    tyres: TyrePrior
    sensors: Sensors
    imus: Mapping[str, Imu]
    """in the order in which they are used"""
    receivers: Mapping[str, Receiver]
    """on its bus; the first places the car, where none on the network does"""
    network_receivers: Mapping[str, Receiver]
    """those that are in `car.toml` alone: the configuration says where they are read"""
    figures: Mapping[str, Figure]
    """`section.key` -> value, deviation and source, in the unit of the section"""

    @property
    def turn_in(self) -> TurnIn:
        """By the linear tyres of Eq. (2): I_z v / (l_f^2 C_f + l_r^2 C_r), inertia over the damping of both axles."""
        v, tyres = self.vehicle, self.tyres
        front = v.lf**2 * tyres.bf * tyres.cf * tyres.df / v.yaw_inertia
        rear = v.lr**2 * tyres.br * tyres.cr * tyres.dr / v.yaw_inertia
        pressed = front * v.lift_area_front + rear * v.lift_area_rear
        return TurnIn(front * v.static_load_front + rear * v.static_load_rear, -0.5 * v.air_density * pressed)

    @property
    def grip_spread(self) -> float:
        """Share of the declared grip by which hardly any tyres have less, or more: two standard deviations."""
        return 2.0 * self.relative_std("tyres.grip")

    @property
    def most_grip(self) -> float:
        """Friction that hardly any tyres exceed."""
        return (1.0 + self.grip_spread) * self.tyres.grip

    @property
    def hold_pressure(self) -> float:
        """Of the brakes, Pa, with which they bear the weight: the car stands on any road."""
        brakes = self.powertrain
        return min(0.5 * self.vehicle.mass * GRAVITY / brakes.brake_force_per_pa, brakes.brake_pressure_max)

    @property
    def codec(self) -> Codec:
        """Frames to quantities and back."""
        return load_codec(self.platform)

    def std(self, key: str) -> float:
        """Standard deviation of `section.key`, in the unit of the section."""
        std = self.figures[key].std
        assert isinstance(std, float)
        return std

    def relative_std(self, key: str) -> float:
        """Standard deviation of `section.key` over its value."""
        value = self.figures[key].value
        assert isinstance(value, float)
        return self.std(key) / abs(value)

    @cached_property
    def sha256(self) -> str:
        """Hash over all files of the folder."""
        return hashlib.sha256("".join(self.files().values()).encode()).hexdigest()

    @property
    def dbc(self) -> Path:
        """Its DBC, for tools that read one themselves."""
        return dbc_path(platform_folder(self.platform))

    @property
    def dbc_sha256(self) -> str:
        """SHA-256 of its DBC."""
        return hashlib.sha256(self.dbc.read_bytes()).hexdigest()

    def files(self) -> dict[str, str]:
        """Name -> text of every file of the folder that says something."""
        folder = platform_folder(self.platform)
        paths = [dbc_path(folder), *(folder / name for name in FILES)]
        return {path.name: read_text(path) for path in paths}


PLATFORM_VARIABLE = "HIL_PLATFORM"
"""what `--platform` sets, for this process and those that it starts"""


def default_platform() -> str:
    """The car that is operated where nobody names another."""
    return os.environ.get(PLATFORM_VARIABLE, DEFAULT_PLATFORM)


def load_car(platform: str | None = None) -> Car:
    """The car of a name or folder, read once a process.

    Raises:
        InputError: no such car, or a mistake in its folder: file, key, value, limit, remedy.
    """
    return _load(platform or default_platform())


@lru_cache(maxsize=64)
def _load(platform: str) -> Car:
    try:
        return _read(platform, load_codec(platform))
    except PlatformError as error:
        raise InputError(str(error)) from None


SECTIONS: dict[str, type[Model]] = {
    "vehicle": Vehicle, "powertrain": Powertrain, "actuators": Actuators, "tyres": TyrePrior, "sensors": Sensors
}  # fmt: skip
S = TypeVar("S", bound=Model)


def _read(platform: str, codec: Codec) -> Car:
    file = _File(platform_folder(platform) / "car.toml")
    name, receivers = file.name(), file.sensors(Receiver, "receiver", codec.signals.receivers, network=True)
    car = Car(
        name=name,
        platform=platform,
        vehicle=file.section(Vehicle, "vehicle"),
        powertrain=file.section(Powertrain, "powertrain"),
        actuators=file.section(Actuators, "actuators"),
        tyres=file.section(TyrePrior, "tyres"),
        sensors=file.section(Sensors, "sensors"),
        imus=file.sensors(Imu, "imu", codec.signals.imus, network=False),
        receivers={name: receivers.pop(name) for name in codec.signals.receivers},
        network_receivers=receivers,
        figures=file.figures,
    )
    if found := car.vehicle.outside_a_race_car():
        raise PlatformError(f"{file.path}: vehicle.{found}")
    return car


class _File:
    """`car.toml` of a folder; `figures` fills with what is read."""

    def __init__(self, path: Path) -> None:
        self.path, self.figures = path, dict[str, Figure]()
        self._tree = read_toml(path)
        if unknown := sorted(set(self._tree) - set(SECTIONS) - {"name", "imu", "receiver"}):
            known = f"name, {', '.join(SECTIONS)}, imu, receiver"
            raise PlatformError(f"{path}: unknown key {unknown[0]}; known are {known}")
        train, tyres, acts = (self._tree.get(key) for key in ("powertrain", "tyres", "actuators"))
        if isinstance(train, dict) and isinstance(tyres, dict) and "cx" in tyres:
            train.setdefault("force_per_drive", tyres["cx"])
        if isinstance(acts, dict) and isinstance(late := acts.get("steering_delay"), dict):
            unknown_delay = {"value": 0.0, "std": late.get("value"), "unit": late.get("unit")}
            acts.setdefault("angle_delay", unknown_delay | {"source": "not given: as late as the steering is at most"})

    def name(self) -> str:
        name = self._tree.get("name")
        if not isinstance(name, str) or not name:
            raise PlatformError(f"{self.path}: name is missing")
        return name

    def section(self, model: type[S], key: str) -> S:
        return self._part(model, self._tree.get(key), key)

    def sensors(self, model: type[S], key: str, wired: tuple[str, ...], *, network: bool) -> dict[str, S]:
        """Those of the bus in the order of `signals.toml`, then those on the network in that of `car.toml`."""
        given = self._tree.get(key, {})
        compared = (wired, given, "car.toml"), (() if network else given, wired, "signals.toml")
        for one, other, file in reversed(compared):
            if lacking := [name for name in one if name not in other]:
                raise PlatformError(
                    f"{self.path}: [{key}.{lacking[0]}] is not in {file}; every sensor of the bus is in both"
                )
        return {name: self._part(model, given[name], f"{key}.{name}") for name in dict.fromkeys((*wired, *given))}

    def _part(self, model: type[S], given: Any, key: str) -> S:
        read, found = read_section(model, given, self.path, key)
        self.figures.update({f"{key}.{name}": figure for name, figure in found.items()})
        return read
