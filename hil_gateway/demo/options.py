"""From command-line flags to the configuration every process of the demo reads."""

from __future__ import annotations

import datetime as dt
import socket
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tomli_w

from hil_gateway.bus.revision_file import read_revision
from hil_gateway.can_link import open_link, resolve_kind
from hil_gateway.config import DEFAULT_ORIGIN, Config, DashboardConfig, load_config, origins
from hil_gateway.demo.folder import CONFIG_NAME, FolderLock, check_drive_folder, claim
from hil_gateway.plant.car_file import SimulatedCar, read_car
from hil_gateway.process.errors import InputError
from hil_gateway.track.loading import load_track

DEFAULT_LAPS = 1


@dataclass(frozen=True)
class DemoOptions:
    """What was asked for. Without `laps` and `seconds`, one lap is driven."""

    laps: int | None = None
    seconds: float | None = None
    track: str = ""
    effects: tuple[str, ...] = ()
    out: Path | None = None
    config_file: Path | None = None
    channel: str = ""
    zenoh_port: int | None = None
    model: str = ""
    dashboard: bool = False
    headless: bool = False
    car: Path | None = None
    learner: bool = True
    """diagnose beside the drive, and drive with what is found"""
    receivers: bool = False
    """positions come from receivers on the network, and none from CAN"""
    stay: bool = False
    """run until interrupted: stops end nothing, and a person cranks and arms"""

    @property
    def target_laps(self) -> int | None:
        """Laps after which the run ends; None: it ends by time."""
        return DEFAULT_LAPS if self.laps is None and self.seconds is None and not self.stay else self.laps


@dataclass(frozen=True)
class DemoSetup:
    """A configuration that has been checked, and where the results go."""

    config: Config
    folder: Path
    bus: str
    """which CAN bus, in words"""
    track_name: str
    lock: FolderLock
    car: SimulatedCar | None = None
    """the simulated car where a file describes it; not in the configuration, which the driving processes read"""

    @property
    def config_file(self) -> Path:
        return self.folder / CONFIG_NAME

    @property
    def session(self) -> Path:
        return self.folder / "session.mcap"


def prepare(options: DemoOptions) -> DemoSetup:
    """Check everything a user can get wrong, before any process starts.

    Raises:
        InputError: one line with the remedy.
    """
    _check_extent(options)
    folder = (options.out or Path("sessions") / f"demo-{dt.datetime.now():%Y%m%d-%H%M%S}").absolute()
    config = load_config(options.config_file, _overrides(options, folder))
    check_drive_folder(folder, _inputs(options), config.recorder.min_free_bytes)
    track = load_track(config.track)
    _check_effects(config)
    car = _read_car(options)
    if options.model:
        read_revision(options.model)
    config = _with_free_ports(config, options)
    open_link(config.can).close()
    kind = resolve_kind(config.can)
    bus = f"socketcan {config.can.channel}" if kind == "socketcan" else kind
    setup = DemoSetup(config, folder, bus, track.name, claim(folder), car)
    written = tomli_w.dumps(config.model_dump(mode="json", exclude_none=True))
    setup.config_file.write_text(written, encoding="utf-8")
    return setup


def _inputs(options: DemoOptions) -> list[Path]:
    """Files that were given, which the drive must not write over."""
    named = (options.config_file, options.track, options.model, options.car)
    return [Path(name) for name in named if name]


def _check_extent(options: DemoOptions) -> None:
    if options.stay and (options.laps is not None or options.seconds is not None):
        raise InputError("--stay: runs until interrupted; leave out --laps and --seconds")
    if options.laps is not None and options.laps < 1:
        raise InputError(f"--laps {options.laps}: at least 1 lap, or leave it out and give --seconds")
    if options.seconds is not None and not 0 < options.seconds < float("inf"):
        raise InputError(f"--seconds {options.seconds}: must be positive")


def _read_car(options: DemoOptions) -> SimulatedCar | None:
    if options.car and options.effects:
        raise InputError(f"--car {options.car}: has its effects in the file; leave out --effect")
    return read_car(options.car) if options.car else None


def _overrides(options: DemoOptions, folder: Path) -> dict[str, Any]:
    values: dict[str, Any] = {"recorder.folder": str(folder), "recorder.name": "session"}
    if options.track:
        values["track"] = str(Path(options.track).absolute()) if Path(options.track).exists() else options.track
    if options.channel:
        values |= {"can.channel": options.channel, "can.interface": "socketcan"}
    if options.effects:
        values["plant.effects"] = parse_effects(options.effects)
        made = origins(options.config_file)
        # what is asked for is then all that the declared model lacks
        values |= {key: "paper" for key in ("plant.base", "declared_model") if made[key][1] == DEFAULT_ORIGIN}
    if options.zenoh_port is not None:
        values["zenoh.connect"] = (f"tcp/127.0.0.1:{options.zenoh_port}",)
    if options.receivers:
        values |= _network_receivers(options)
    if options.model:
        values["estimator.model"] = values["planner.model"] = str(Path(options.model).absolute())
    return values


def _network_receivers(options: DemoOptions) -> dict[str, Any]:
    """Those of the car folder, each on a free port of this computer, whose clock is that of the satellites."""
    names = load_config(options.config_file).car.network_receivers
    if not names:
        raise InputError("--receivers: the car folder has none on the network (car.toml, and not in signals.toml)")
    read = {n: {"address": f"tcp://127.0.0.1:{_free_port(socket.SOCK_STREAM)}", "clock": "gps"} for n in names}
    return {"receivers": read, "plant.receivers": True, "plant.can_positions": False}


def parse_effects(texts: Sequence[str]) -> dict[str, float]:
    """NAME=SIZE pairs.

    Raises:
        InputError: not of this form.
    """
    sizes: dict[str, float] = {}
    for text in texts:
        name, equals, size = text.partition("=")
        try:
            sizes[name.strip()] = float(size)
        except ValueError:
            equals = ""
        if not equals:
            raise InputError(f"--effect {text}: expected NAME=SIZE with a number, for example aero_drag=0.6")
    return sizes


def _check_effects(config: Config) -> None:
    from hil_gateway.plant.physics.effects import configure

    configure(config.plant.base, config.plant.effects)


def _with_free_ports(config: Config, options: DemoOptions) -> Config:
    """Ports nobody uses, unless the user named them: several demos can run on one computer."""
    if options.zenoh_port is not None:
        _check_port(options.zenoh_port)
    elif config.zenoh == Config().zenoh:
        zenoh = config.zenoh.model_copy(update={"connect": (f"tcp/127.0.0.1:{_free_port(socket.SOCK_STREAM)}",)})
        config = config.model_copy(update={"zenoh": zenoh})
    if resolve_kind(config.can) == "udp_multicast" and config.can == Config().can:
        can = config.can.model_copy(update={"multicast_port": _free_port(socket.SOCK_DGRAM)})
        config = config.model_copy(update={"can": can})
    return _with_free_page(config) if options.dashboard else config


def _with_free_page(config: Config) -> Config:
    """The page on its port, or on a free one where it is taken and nobody asked for this one.

    Raises:
        InputError: the address or port that was asked for cannot be used.
    """
    page = config.dashboard
    reason = _why_not(page.host, page.port)
    if reason and page == DashboardConfig():
        page = page.model_copy(update={"port": _free_port(socket.SOCK_STREAM)})
        return config.model_copy(update={"dashboard": page})
    if reason:
        raise InputError(
            f"dashboard: {page.host}:{page.port} cannot be used: {reason}; set dashboard.host and dashboard.port"
            " in the --config file to others, or leave them out and a free port is taken"
        )
    return config


def _check_port(port: int) -> None:
    if reason := _why_not("127.0.0.1", port):
        raise InputError(f"--zenoh-port {port}: cannot be used: {reason}; leave it out and a free one is taken")


def _why_not(host: str, port: int) -> str:
    """Why nothing can listen there; empty when it can."""
    with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # as whoever listens there will: not the last one
        try:
            probe.bind((host, port))
            probe.listen()
        except (OSError, OverflowError) as error:
            return getattr(error, "strerror", None) or str(error)
    return ""


def _free_port(kind: socket.SocketKind) -> int:
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
