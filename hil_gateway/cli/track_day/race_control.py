"""`hil race-control`: what the base station shows to the simulated car."""

from __future__ import annotations

import os
import time
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from hil_gateway.process.errors import InputError

app = typer.Typer(
    no_args_is_help=True,
    help="Flags, speed and kill to the simulated car, as the base station sends them; never to a real one.",
)
ConfigOption = Annotated[Path | None, typer.Option("--config", help="TOML configuration")]


class TrackFlagName(StrEnum):
    """Shown to everybody."""

    GREEN = "green"
    YELLOW = "yellow"
    RED = "red"
    CHECKERED = "checkered"


class CarFlagName(StrEnum):
    """Shown to this car alone."""

    NONE = "none"
    BLACK = "black"
    YELLOW = "yellow"
    STOP = "stop"
    PURPLE = "purple"


@app.command()
def flag(name: TrackFlagName, config: ConfigOption = None) -> None:
    """Show a flag to everybody; yellow is full-course."""
    from hil_gateway.car.states import TrackFlag

    wanted = "full_course_yellow" if name is TrackFlagName.YELLOW else name.value
    _show(config, track_flag=TrackFlag[wanted.upper()])


@app.command()
def car(name: CarFlagName, config: ConfigOption = None) -> None:
    """Show a flag to this car alone; none takes it back."""
    from hil_gateway.car.states import VehicleFlag

    _show(config, vehicle_flag=VehicleFlag[name.name])


@app.command()
def kill(config: ConfigOption = None) -> None:
    """E-kill: the car cuts its engine and brakes. `car none` takes it back."""
    from hil_gateway.car.states import VehicleFlag

    _show(config, vehicle_flag=VehicleFlag.E_KILL)


@app.command()
def speed(
    metres_per_second: Annotated[float, typer.Argument(min=0, max=100, help="0: none named")],
    config: ConfigOption = None,
) -> None:
    """Name the speed to keep under yellow."""
    _show(config, target_speed=metres_per_second)


@app.command()
def heartbeat(state: Annotated[bool, typer.Argument(help="on or off")], config: ConfigOption = None) -> None:
    """Let the heartbeat of the base station stand still, or go on."""
    _show(config, beating=state)


@app.command()
def show(config: ConfigOption = None) -> None:
    """Say what is shown now."""
    _show(config)


def _show(config: Path | None, **change: Any) -> None:
    """Ask for a change, wait until it is shown, and say what the gateway makes of it."""
    from hil_gateway.bus import topics
    from hil_gateway.bus.track_day.race_control import RaceControlRequest
    from hil_gateway.bus.zenoh_bus import open_bus
    from hil_gateway.config import load_config
    from hil_gateway.gateway.asking import address, wait

    reached, now = address(load_config(config).zenoh, config), time.monotonic_ns()
    bus = open_bus(reached.zenoh, "operator")
    try:
        shown, statuses = bus.subscribe(topics.RACE_CONTROL), bus.subscribe(topics.GATEWAY_STATUS)
        if wait(shown, lambda _: True) is None:
            endpoints = ", ".join(reached.zenoh.connect)
            raise InputError(f"no simulated car answers at {endpoints}; the flags of a real one are race control's own")
        request = RaceControlRequest(stamp_ns=now, seq=now // 1000, source=f"cli-{os.getpid()}", **change)
        publish = partial(bus.publish, topics.RACE_CONTROL_REQUEST, request) if change else None
        answer = wait(shown, lambda message: message.shows(request), publish)
        if answer is None or not answer.shows(request):
            raise InputError("the simulated car does not show it: is another desk at work?")
        typer.echo(_described(answer))
        status = wait(statuses, lambda _: False, seconds=REACTION_S)
        if status is not None:
            typer.echo(f"gateway: {status.action.value}{': ' + status.cause if status.cause else ''}")
    finally:
        bus.close()


REACTION_S = 0.5
"""until the car has passed a flag on and the gateway has answered it: two periods of its bus, one of the status"""


def _described(shown: Any) -> str:
    speed = f"{shown.target_speed:g} m/s" if shown.target_speed else "none named"
    heart = "" if shown.beating else ", heartbeat stands still"
    track, car = (flag.name.lower().replace("_", " ") for flag in (shown.track_flag, shown.vehicle_flag))
    return f"track flag {track}, flag of the car {car}, speed under yellow {speed}{heart}"
