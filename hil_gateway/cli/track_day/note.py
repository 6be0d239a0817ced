"""`hil note`: a remark, the tyre set or the weather into the running recording."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Annotated

import typer
from pydantic import ValidationError

from hil_gateway.process.errors import InputError

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

    now = time.monotonic_ns()
    head = {"stamp_ns": now, "seq": now // 1000, "source": f"cli-{os.getpid()}"}
    try:
        message = Note(**head, text=text, tyres=tyres, air_c=air, road_c=road)
    except ValidationError as error:
        raise InputError(f"a note: {error.errors()[0]['loc'][0]}: {error.errors()[0]['msg'].lower()}") from None
    if not (text or tyres or air is not None or road is not None):
        raise InputError("a note is a text, --tyres NAME, --air or --road")
    reached = address(load_config(config).zenoh, config)
    bus = open_bus(reached.zenoh, "operator")
    try:
        statuses = bus.subscribe(topics.RECORDER_STATUS)
        before = wait(statuses, lambda status: status.recording)
        if before is None or not before.recording:
            raise InputError("nothing is recorded, so the note would be lost: `hil recorder run`")
        bus.publish(topics.NOTE, message)
        after = wait(statuses, lambda status: status.noted == message.seq)
        if after is None or after.noted != message.seq:
            raise InputError("the recorder has not confirmed the note: say it again")
    finally:
        bus.close()
    typer.echo(f"noted in {before.file}")


app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
app.command()(note)
