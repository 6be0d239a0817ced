"""One frozen configuration tree: defaults here, then a TOML file, then HIL_... variables, then flags.

An unknown key, a value out of range or an unreadable file is an `InputError` that names file, key, value and
remedy. `HIL_CAN__CHANNEL=can0` sets `can.channel`; lists and tables are written as in TOML.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import Field, ValidationError, model_validator

from hil_gateway.car.car import Car, Receiver, default_platform, load_car
from hil_gateway.car.powertrain import Powertrain
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.process.errors import InputError
from hil_gateway.process.model import Model
from hil_gateway.settings.gateway import GatewayConfig, stop_of
from hil_gateway.settings.joystick import JoystickConfig
from hil_gateway.settings.receivers import ReceiverConfig
from hil_gateway.settings.ros2 import Ros2Config
from hil_gateway.text_file import parse_toml, read_toml

ENVIRONMENT_PREFIX = "HIL_"
DEFAULT_ORIGIN = "default"
"""where a setting came from that nobody made"""


class CanConfig(Model):
    """Which CAN bus, and how."""

    interface: Literal["auto", "socketcan", "udp_multicast", "virtual"] = "auto"
    channel: str = "vcan0"
    bitrate: int | None = Field(default=None, gt=0, description="bit/s; not given: that of the car's bus")
    multicast_group: str = "239.74.163.2"
    multicast_port: int = Field(default=43113, gt=0, lt=65536)


class ZenohConfig(Model):
    """Explicit Zenoh endpoints; loopback unless changed. The gateway listens, the others connect.

    Not 7447: that is the port of `rmw_zenohd`, and ROS nodes would join this bus.
    """

    listen: tuple[str, ...] = ()
    connect: tuple[str, ...] = ("tcp/127.0.0.1:7448",)
    mode: Literal["peer", "client"] = Field(
        default="peer", description="client: everything goes through the router that `connect` names"
    )
    extra: str = Field(default="", description="path of a Zenoh JSON5 file merged over these (TLS, access control)")


class OriginConfig(Model):
    """Geodetic origin of the local map frame."""

    latitude: float = Field(default=36.5844, ge=-90, le=90, description="deg")
    longitude: float = Field(default=-121.7535, ge=-180, le=180, description="deg")


class PlantConfig(Model):
    """Simulated car."""

    base: Literal["av24", "paper"] = Field(default="av24", description="realistic car, or nearly that of Eq. 1-3")
    effects: dict[str, float] = Field(default={}, description="undeclared effect -> size (docs/plant.md)")
    car: dict[str, float] = Field(default={}, description="single numbers of the simulated car, SI")
    start_s: float = Field(default=0.0, ge=0, description="where on the track the car stands at first, m")
    seed: int = Field(default=1, ge=0, description="of all sensor noise")
    receivers: bool = Field(default=False, description="it has those of [receivers], and serves their addresses")
    can_positions: bool = Field(default=True, description="positions are on its CAN, too")


class EstimatorConfig(Model):
    """Estimator process."""

    layout: Literal["shared", "per_axle"] = "per_axle"
    measurement: Literal["imu", "imu_yaw", "tyre_force"] = "imu_yaw"
    model: str = Field(default="", description="model revision (JSON) to start from; empty: the declared model")
    learn: bool = Field(default=True, description="learn tyres and effects; off: they stay as the model states them")
    relinearise: bool = Field(default=True, description="linearise Eq. (8) again over a history, once a second")
    revision_hysteresis: float = Field(default=0.02, gt=0, description="smallest relative change worth publishing")
    revision_max_step: float = Field(default=0.2, gt=0, description="largest relative change of a parameter at once")
    revision_min_samples: int = Field(default=200, ge=1, description="samples before the first change")
    revision_bounds: tuple[float, float] = Field(
        default=(0.5, 2.0), description="published tyre parameters over the starting ones"
    )


Backend = Literal["auto", "fixed", "hpipm", "piqp"]
"""QP solvers (planner/solver/choice.py); auto: the fastest that works here"""


class PlannerConfig(Model):
    """Planner process."""

    horizon: int = Field(default=40, ge=5, le=200)
    dt: float = Field(default=0.05, gt=0, le=0.5, description="s")
    backend: Backend = "auto"
    model: str = Field(default="", description="model revision (JSON) to start from; empty: the declared model")
    information_weight: float = Field(default=0.0, ge=0, description="q_I of Eq. (9); 0 is the plain MPCC")
    information_goal: float = Field(
        default=0.0, ge=0, lt=1, description="spread of the belief over the prior's at which exploring ends; 0: never"
    )
    information_bound: float = Field(default=400.0, gt=0, description="largest Delta I of one stage, Eq. (9)")
    information_criterion: Literal["trace", "log_det"] = "trace"
    convexification: Literal["abs", "projection"] = "abs"
    load_limit: Literal["ellipse", "literal"] = "ellipse"
    sigma_level: float = Field(default=2.0, ge=0, le=3, description="Eq. (10) holds at this many sigma of the belief")
    load_use: float = Field(default=0.98, gt=0, le=1, description="share of its tyres' peak force an axle may use")
    load_limits: str = Field(default="", description="file of loads held, carried from run to run; empty: first run")
    run_caps: str = Field(default="", description="file of the caps that clean runs have reached; empty: not kept")
    caps_without_run: bool = Field(
        default=False, description="the caps of a car and a model that have not driven hold without `hil run`, too"
    )
    estimate_age_s: float = Field(default=0.01, ge=0, le=0.2, description="age of an estimate when it arrives")
    compute_s: float = Field(default=0.004, ge=0, le=0.05, description="time from estimate to command, expected")
    deadline_s: float = Field(default=0.04, gt=0, description="a solution later than this is not used")


class RecorderConfig(Model):
    """Recording of raw frames and topics."""

    flush_s: float = Field(default=0.1, gt=0, le=0.2, description="at most this much is lost by a kill, s")
    folder: str = Field(default="sessions", description="where recordings go")
    name: str = Field(default="", pattern="^[^/]*$", description="name of the recording; empty: date and time")
    rotate_bytes: int = Field(default=2_000_000_000, ge=100_000, description="size at which the next file begins, B")
    min_free_bytes: int = Field(default=300_000_000, ge=0, description="recording pauses below this free space, B")


class DashboardConfig(Model):
    """Read-only live page."""

    host: str = Field(default="127.0.0.1", description="address to serve on; loopback unless changed")
    port: int = Field(default=8024, gt=0, lt=65536)
    rate_hz: float = Field(default=10.0, gt=0, le=50, description="updates a second sent to each page")


class Config(Model):
    """The whole tree."""

    declared_model: Literal["race_car", "paper"] = Field(
        default="race_car", description="what is driven with at first: with air, load transfer, both brakes, or Eq. 1-3"
    )
    platform: str = Field(
        default_factory=default_platform, description="the car that is operated: name of a shipped one, or a folder"
    )
    vehicle: Vehicle = Field(default_factory=lambda: load_car().vehicle, description="the car's, where not given")
    powertrain: Powertrain = Field(default_factory=lambda: load_car().powertrain, description="as vehicle")
    track: str = Field(default="", description="track file; empty: the road course that is shipped")
    origin: OriginConfig = OriginConfig()
    can: CanConfig = CanConfig()
    zenoh: ZenohConfig = ZenohConfig()
    gateway: GatewayConfig = GatewayConfig()
    plant: PlantConfig = PlantConfig()
    estimator: EstimatorConfig = EstimatorConfig()
    planner: PlannerConfig = PlannerConfig()
    recorder: RecorderConfig = RecorderConfig()
    dashboard: DashboardConfig = DashboardConfig()
    ros2: Ros2Config = Ros2Config()
    joystick: JoystickConfig = JoystickConfig()
    receivers: dict[str, ReceiverConfig] = Field(
        default={}, max_length=8, description="receivers on the network that place the car, the first one first"
    )

    @property
    def car(self) -> Car:
        """What its folder says of the car."""
        return load_car(self.platform)

    @property
    def declared_car(self) -> Car:
        """The same with the numbers that this configuration gives in their place: what is driven with."""
        return self.car.model_copy(update={"vehicle": self.vehicle, "powertrain": self.powertrain})

    @property
    def placing(self) -> Receiver:
        """The receiver that places the car: the first one on the network, else the first one of its bus."""
        network, wired = self.car.network_receivers, self.car.receivers
        return next((network[name] for name in self.receivers), next(iter(wired.values())))

    @model_validator(mode="before")
    @classmethod
    def _of_the_car(cls, tree: Any) -> Any:
        """Numbers of the car, where the configuration does not give others."""
        if not isinstance(tree, dict):
            return tree
        car = load_car(str(tree.get("platform") or default_platform()))
        of_car: dict[str, Any] = {
            "platform": car.platform, "vehicle": car.vehicle.model_dump(), "powertrain": car.powertrain.model_dump(),
            "gateway": {"stop": stop_of(car)},
        }  # fmt: skip
        return _merged(of_car, tree)

    @model_validator(mode="after")
    def _drives_a_race_car(self) -> Self:
        if found := self.vehicle.outside_a_race_car():
            raise ValueError(f"vehicle.{found}")
        return self

    @model_validator(mode="after")
    def _moves(self) -> Self:
        self.gateway.limits.within(self.car)
        return self

    @model_validator(mode="after")
    def _receivers_are_declared(self) -> Self:
        known = self.car.network_receivers
        if unknown := [name for name in self.receivers if name not in known]:
            raise ValueError(
                f"receivers.{unknown[0]}: no such receiver on the network; {self.platform} has "
                f"{', '.join(known) or 'none'} (car.toml, and not in signals.toml)"
            )
        return self

    @model_validator(mode="after")
    def _stops(self) -> Self:
        """The declared brakes must be able to do what stopping asks of them."""
        force, stop = self.powertrain.hardest_braking, self.gateway.stop
        if force < self.vehicle.mass * stop.emergency_deceleration:
            raise ValueError(
                f"the brakes give {force / self.vehicle.mass:.1f} m/s2 at brake_pressure_max, "
                f"emergency_deceleration asks for {stop.emergency_deceleration:g}"
            )
        return self


def _merged(own: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """`own` with what is `given` in its place, table by table."""
    both = {key: value for key, value in given.items() if isinstance(value, dict) and isinstance(own.get(key), dict)}
    return {**own, **given, **{key: _merged(own[key], value) for key, value in both.items()}}


def load_config(path: Path | None = None, overrides: Mapping[str, Any] | None = None) -> Config:
    """Merge defaults, TOML file, environment and dotted `overrides` ("can.channel": "can0").

    Raises:
        InputError: unreadable file, unknown key, value out of range.
    """
    tree: dict[str, Any] = _read_toml(path) if path else {}
    for keys, value in _environment().items():
        _set(tree, keys, value)
    for key, value in (overrides or {}).items():
        _set(tree, key.split("."), value)
    try:
        return Config.model_validate(tree)
    except ValidationError as error:
        raise InputError(_explain(error, path, overrides or {})) from None


def origins(path: Path | None = None) -> dict[str, tuple[Any, str]]:
    """Every setting as dotted key -> (value, where it came from: the file, a variable, or "default")."""
    in_file = dict(_leaves(_read_toml(path))) if path else {}

    def origin(key: str) -> str:
        if variable := _variable(key):
            return variable
        named = any(key == k or key.startswith(f"{k}.") or k.startswith(f"{key}.") for k in in_file)
        return str(path) if named else DEFAULT_ORIGIN

    tree = load_config(path).model_dump(mode="json")
    return {key: (value, origin(key)) for key, value in _leaves(tree)}


def _leaves(tree: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in tree.items():
        if isinstance(value, dict) and value:
            yield from _leaves(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def _read_toml(path: Path) -> dict[str, Any]:
    return read_toml(path, "configuration")


def _environment() -> dict[tuple[str, ...], Any]:
    """HIL_CAN__CHANNEL -> ("can", "channel"); variables that name no section are not configuration.

    Raises:
        InputError: a section and a key with one underscore between, or a key without its section: it would be ignored,
            and the default hold.
    """
    found: dict[tuple[str, ...], Any] = {}
    for name, value in os.environ.items():
        if not name.startswith(ENVIRONMENT_PREFIX):
            continue
        path = name.removeprefix(ENVIRONMENT_PREFIX).lower()
        section, _, rest = path.partition("_")
        if "__" in path or path in Config.model_fields:
            found[tuple(path.split("__"))] = _from_text(name, value)
        elif section in Config.model_fields:
            meant = f"{ENVIRONMENT_PREFIX}{section}__{rest}".upper()
            raise InputError(f"{name}: no setting; {meant} sets {section}.{rest} (two underscores)")
        elif sections := _sections_with(path):
            meant = " or ".join(f"{ENVIRONMENT_PREFIX}{section}__{path}".upper() for section in sections)
            raise InputError(f"{name}: no setting; meant is {meant}")
    return found


def _sections_with(key: str) -> list[str]:
    """Sections with a key of this name."""
    return [n for n, field in Config.model_fields.items() if key in getattr(field.annotation, "model_fields", ())]


def _variable(key: str) -> str:
    """The variable that sets a dotted key, the list or table it is in, or something in it; empty: none."""
    parts = key.upper().split(".")
    names = [ENVIRONMENT_PREFIX + "__".join(parts[:count]) for count in range(len(parts), 0, -1)]
    below = (name for name in os.environ if name.startswith(f"{names[0]}__"))  # of a table that does not exist
    return next((name for name in names if name in os.environ), "") or next(below, "")


def _from_text(name: str, text: str) -> Any:
    """Lists and tables as TOML writes them; anything else stays text, which pydantic turns into the key's type."""
    if not text.startswith(("[", "{")):
        return text
    try:
        return parse_toml(f"{name}={text[:80]}", f"value = {text}")["value"]
    except InputError as error:
        raise InputError(f"{error}; lists and tables are written as in TOML") from None


def _set(tree: dict[str, Any], keys: Any, value: Any) -> None:
    *parents, leaf = keys
    for key in parents:
        tree = tree.setdefault(key, {})
        if not isinstance(tree, dict):
            return  # a value where a table should be: what checks the tree will say so
    tree[leaf] = value


KINDS = {"tuple_type": "should be a list: [...]", "model_type": "should be a table", "dict_type": "should be a table"}
"""errors whose own words speak of Python -> what a user can do with"""


def _explain(error: ValidationError, path: Path | None, overrides: Mapping[str, Any]) -> str:
    """First problem in one line, with the place it comes from."""
    first = error.errors()[0]
    key = ".".join(str(part) for part in first["loc"])
    where = "command line" if key in overrides else _variable(key) or str(path or "defaults")
    if first["type"] == "value_error":  # several keys that do not go together: the message says which
        return f"{where}: {key + ': ' if key else ''}{first['ctx']['error']}"
    if first["type"] == "extra_forbidden":
        return f"{where}: unknown key {key}; `hil config show` lists the known ones"
    return f"{where}: {key} = {first['input']!r}: {KINDS.get(first['type'], first['msg'].lower())}"
