"""`hil demo`: drive a simulated AV-24 around a track."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hil_gateway.process.errors import EXIT_FAILURE, EXIT_SIGNAL
from hil_gateway.process.figures import print_json

EFFECT_LAPS = 6
"""with an effect and no number of laps: three to learn from, one while the planner takes it, two that show it"""

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)


@app.command()
def demo(
    *,
    laps: Annotated[int | None, typer.Option(help="end after this many laps (default 1)")] = None,
    seconds: Annotated[float | None, typer.Option(help="end after this time under way")] = None,
    track: Annotated[str, typer.Option(help="track file, or the name of a shipped track")] = "",
    effect: Annotated[list[str] | None, typer.Option(help="NAME=SIZE: what the declared car has besides")] = None,
    car: Annotated[Path | None, typer.Option(help="simulated car (JSON); what drives never reads it")] = None,
    out: Annotated[Path | None, typer.Option(help="folder for session.mcap and logs")] = None,
    config_file: Annotated[Path | None, typer.Option("--config", help="TOML file")] = None,
    channel: Annotated[str, typer.Option(help="SocketCAN interface (default: vcan0 where there is one)")] = "",
    zenoh_port: Annotated[int | None, typer.Option(help="TCP port of the gateway (default: a free one)")] = None,
    model: Annotated[str, typer.Option(help="model revision (model.json) to start from")] = "",
    learn: Annotated[
        bool | None,
        typer.Option(
            "--learn/--no-learn",
            help="diagnose the whole drive too and drive again; --no-learn: never diagnose (default: beside the drive)",
        ),
    ] = None,
    receivers: Annotated[
        bool, typer.Option("--receivers", help="positions from NovAtel receivers on the network, and none on CAN")
    ] = False,
    stay: Annotated[
        bool, typer.Option("--stay", help="until Ctrl-C: a person cranks and arms, stops end nothing")
    ] = False,
    dashboard: Annotated[bool, typer.Option("--dashboard", help="also serve the live page")] = False,
    headless: Annotated[bool, typer.Option("--headless", help="no live view")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="one JSON object on standard output")] = False,
) -> None:
    """Plant, gateway, estimator, planner and recorder as separate processes over a CAN bus and Zenoh.

    Exit 0: driven as asked; 1: something went wrong on the way; 2: bad arguments; 130: Ctrl-C; 143: SIGTERM.
    """
    from hil_gateway.demo.drive import drive
    from hil_gateway.demo.learn import DEFAULT_LAPS, describe_learning, drive_learn_drive
    from hil_gateway.demo.options import DemoOptions
    from hil_gateway.demo.summary import describe

    effects = tuple(effect or ())
    if laps is None and seconds is None:
        laps = DEFAULT_LAPS if learn else EFFECT_LAPS if effects else None
    options = DemoOptions(
        laps,
        seconds,
        track,
        effects,
        out,
        config_file,
        channel,
        zenoh_port,
        model,
        dashboard,
        headless,
        car,
        learner=learn is not False,
        receivers=receivers,
        stay=stay,
    )
    summary = drive_learn_drive(options) if learn else drive(options)
    lines = [*describe(summary), *describe_learning(summary)]
    if as_json:
        print_json(summary)
    else:
        print("\n".join(lines))
    if summary["signal"]:
        raise typer.Exit(EXIT_SIGNAL + summary["signal"])
    if not summary["ok"]:
        raise typer.Exit(EXIT_FAILURE)
