"""`hil note`: a remark, the tyre set or the weather into the running recording."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Annotated

import typer

from hil_gateway.process.errors import InputError

TEXT_MAX = 4000
Celsius = typer.Option(min=-50.0, max=100.0, help="deg C")


def note(
    text: Annotated[str, typer.Argument(help='as "front wing +1"')] = "",
    tyres: Annotated[str, typer.Option(help="the tyre set that is on from now on")] = "",
    air: Annotated[float | None, Celsius] = None,
    road: Annotated[float | None, Celsius] = None,
    config: Annotated[Path | None, typer.Option("--config", help="TOML configuration")] = None,
) -> None:
    """Put a remark, the tyre set that is on, or the temperature of air and road into the running recording."""
    from hil_gateway.bus import topics
    from hil_gateway.bus.track_day.note import Note
    from hil_gateway.bus.zenoh_bus import open_bus
    from hil_gateway.config import load_config
    from hil_gateway.gateway.asking import address, wait

    if not (text or tyres or air is not None or road is not None) or len(text) > TEXT_MAX or len(tyres) > 64:
        raise InputError(f"a note is a text of up to {TEXT_MAX} characters, --tyres NAME of up to 64, --air or --road")
    reached, now = address(load_config(config).zenoh, config), time.monotonic_ns()
    bus = open_bus(reached.zenoh, "operator")
    try:
        statuses = bus.subscribe(topics.RECORDER_STATUS)
        before = wait(statuses, lambda status: status.recording)
        if before is None or not before.recording:
            raise InputError("nothing is recorded, so the note would be lost: `hil recorder run`")
        head = {"stamp_ns": now, "seq": now // 1000, "source": f"cli-{os.getpid()}"}
        message = Note(**head, text=text, tyres=tyres, air_c=air, road_c=road)
        bus.publish(topics.NOTE, message)
        after = wait(statuses, lambda status: status.noted == message.seq)
        if after is None or after.noted != message.seq:
            raise InputError("the recorder has not confirmed the note: say it again")
    finally:
        bus.close()
    typer.echo(f"noted in {before.file}")


app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
app.command()(note)
