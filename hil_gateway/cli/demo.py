"""`hil demo`: drive a simulated AV-24 around a track."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hil_gateway.process.errors import EXIT_FAILURE, EXIT_SIGNAL
from hil_gateway.process.figures import print_json

if TYPE_CHECKING:
    from hil_gateway.demo.options import DemoOptions

EFFECT_LAPS = 6
"""with an effect and no number of laps: three to learn from, one while the planner takes it, two that show it"""

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)


Laps = Annotated[int | None, typer.Option(help="end after this many laps (default 1)")]
Seconds = Annotated[float | None, typer.Option(help="end after this time under way")]
TrackName = Annotated[str, typer.Option(help="track file, or the name of a shipped track")]
Effects = Annotated[list[str] | None, typer.Option(help="NAME=SIZE: what the declared car has besides")]
CarFile = Annotated[Path | None, typer.Option(help="simulated car (JSON); what drives never reads it")]
Out = Annotated[Path | None, typer.Option(help="folder for session.mcap and logs")]
ConfigFile = Annotated[Path | None, typer.Option("--config", help="TOML file")]
Channel = Annotated[str, typer.Option(help="SocketCAN interface (default: vcan0 where there is one)")]
Port = Annotated[int | None, typer.Option(help="TCP port of the gateway (default: a free one)")]
Model = Annotated[str, typer.Option(help="model revision (model.json) to start from")]
Learn = Annotated[
    bool, typer.Option("--learn/--no-learn", help="diagnose the laps beside the drive, and drive with what is found")
]
Receivers = Annotated[
    bool, typer.Option("--receivers", help="positions from NovAtel receivers on the network, and none on CAN")
]
Stay = Annotated[
    bool,
    typer.Option("--stay", help="until Ctrl-C: a person cranks and arms, starts again what died; stops end nothing"),
]
Dashboard = Annotated[bool, typer.Option("--dashboard", help="also serve the live page")]
Headless = Annotated[bool, typer.Option("--headless", help="no live view")]
AsJson = Annotated[bool, typer.Option("--json", help="one JSON object on standard output")]


@app.command()
def demo(
    *,
    laps: Laps = None,
    seconds: Seconds = None,
    track: TrackName = "",
    effect: Effects = None,
    car: CarFile = None,
    out: Out = None,
    config_file: ConfigFile = None,
    channel: Channel = "",
    zenoh_port: Port = None,
    model: Model = "",
    learn: Learn = True,
    receivers: Receivers = False,
    stay: Stay = False,
    dashboard: Dashboard = False,
    headless: Headless = False,
    as_json: AsJson = False,
) -> None:
    """Plant, gateway, estimator, planner and recorder as separate processes over a CAN bus and Zenoh.

    Exit 0: driven as asked; 1: something went wrong on the way; 2: bad arguments; 130: Ctrl-C; 143: SIGTERM.
    """
    from hil_gateway.demo.options import DemoOptions

    effects = tuple(effect or ())
    if laps is None and seconds is None:
        laps = EFFECT_LAPS if effects else None
    where = (track, effects, out, config_file, channel, zenoh_port, model)
    options = DemoOptions(
        laps, seconds, *where, dashboard, headless, car, learner=learn, receivers=receivers, stay=stay
    )
    _drive(options, as_json)


def _drive(options: DemoOptions, as_json: bool) -> None:
    """Drive, print the summary and end with its exit code."""
    from hil_gateway.demo.drive import drive
    from hil_gateway.demo.summary import describe

    summary = drive(options)
    if as_json:
        print_json(summary)
    else:
        print("\n".join(describe(summary)))
    if summary["signal"]:
        raise typer.Exit(EXIT_SIGNAL + summary["signal"])
    if not summary["ok"]:
        raise typer.Exit(EXIT_FAILURE)
