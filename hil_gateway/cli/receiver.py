"""`hil receiver`: what a GNSS or INS receiver sends and whether it may be used; the process that publishes it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(no_args_is_help=True, help="GNSS and INS receivers: NovAtel OEM7 binary logs and NMEA.")


@app.command()
def run(config: Annotated[Path | None, typer.Option("--config", help="configuration (TOML)")] = None) -> None:
    """Publish what the receivers of the configuration say of position, velocity, heading and rates, until stopped."""
    from hil_gateway.config import load_config
    from hil_gateway.receiver.node import run as run_receivers

    run_receivers(load_config(config))


@app.command()
def check(
    source: Annotated[str, typer.Argument(help="tcp://HOST:PORT, serial device, or a captured file")],
    seconds: Annotated[float, typer.Option(min=0.1, max=3600, help="how long to listen")] = 5.0,
    baud: Annotated[int, typer.Option(help="of a serial line")] = 115200,
    json: Annotated[bool, typer.Option("--json", help="one JSON object on standard output")] = False,
) -> None:
    """Listen, and say which logs come, how often, and what the receiver's own status allows them for."""
    import json as encoder
    import time

    from hil_gateway.process.errors import EXIT_FAILURE
    from hil_gateway.receiver.check import Check
    from hil_gateway.receiver.source import chunks

    found, end = Check(), time.monotonic() + seconds
    for data in chunks(source, baud):
        found.take(data)
        if time.monotonic() > end:
            break
    report = found.report()
    if json:
        typer.echo(encoder.dumps(report))
    else:
        for name, row in report["logs"].items():
            rate = "" if row["rate_hz"] is None else f"{row['rate_hz']:g} Hz"
            why = "; ".join(f"{reason}: {count}" for reason, count in row["reasons"].items())
            typer.echo(f"{name:20} {row['count']:6} {rate:9} fixed {row['fixed']}, refused {row['refused']}  {why}")
        typer.echo("a position may be used" if found.usable else "no position that may be used")
    if not found.usable:
        raise typer.Exit(EXIT_FAILURE)
