"""`hil demo`: drive a simulated AV-24 around a track."""

from __future__ import annotations

import contextlib
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hil_gateway.errors import EXIT_FAILURE

if TYPE_CHECKING:
    from hil_gateway.demo.options import DemoOptions, DemoSetup
    from hil_gateway.demo.run import RunResult
    from hil_gateway.demo.view import View

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)


@app.command()
def demo(
    *,
    laps: Annotated[int | None, typer.Option(help="end after this many laps (default 1)")] = None,
    seconds: Annotated[float | None, typer.Option(help="end after this time under way")] = None,
    track: Annotated[str, typer.Option(help="track file, or the name of a shipped track")] = "",
    effect: Annotated[list[str] | None, typer.Option(help="NAME=SIZE: what the car has and the model lacks")] = None,
    out: Annotated[Path | None, typer.Option(help="folder for session.mcap and logs")] = None,
    config_file: Annotated[Path | None, typer.Option("--config", help="TOML file")] = None,
    channel: Annotated[str, typer.Option(help="SocketCAN interface (default: vcan0 where there is one)")] = "",
    zenoh_port: Annotated[int | None, typer.Option(help="TCP port of the gateway (default: a free one)")] = None,
    model: Annotated[str, typer.Option(help="model revision (model.json) to start from")] = "",
    dashboard: Annotated[bool, typer.Option("--dashboard", help="also serve the live page")] = False,
    headless: Annotated[bool, typer.Option("--headless", help="no live view")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="one JSON object on standard output")] = False,
) -> None:
    """Plant, gateway, estimator, planner and recorder as separate processes over a CAN bus and Zenoh.

    Exit 0: driven as asked; 1: something went wrong on the way; 2: bad arguments.
    """
    from hil_gateway.demo.options import DemoOptions, prepare
    from hil_gateway.demo.summary import describe, summarise

    options = DemoOptions(laps, seconds, track, tuple(effect or ()), out, config_file, channel, zenoh_port, model)
    setup = prepare(options)
    print(f"CAN bus: {setup.bus}; session: {setup.session}", file=sys.stderr)
    if dashboard:
        print(f"dashboard: http://{setup.config.dashboard.host}:{setup.config.dashboard.port}/", file=sys.stderr)
    result = _run(options, setup, headless)
    summary = summarise(options, setup, result, _model_error(setup, result))
    print(json.dumps(summary) if as_json else "\n".join(describe(summary)))
    if not summary["ok"]:
        raise typer.Exit(EXIT_FAILURE)


def _model_error(setup: DemoSetup, result: RunResult) -> dict[str, Any]:
    from hil_gateway.demo.model_error import measure, unknown
    from hil_gateway.demo.run import Ending

    if result.ending is not Ending.DONE:  # who interrupts does not want to wait
        return unknown(f"the run ended early: {result.ending.value}")
    print("measuring the model error on the recording", file=sys.stderr)
    return measure(setup)


def _run(options: DemoOptions, setup: DemoSetup, headless: bool) -> RunResult:
    from hil_gateway.demo.run import Run
    from hil_gateway.process import stop_requested
    from hil_gateway.supervisor import DASHBOARD, PROCESSES, Supervisor

    stopping = stop_requested()
    specs = (*PROCESSES, DASHBOARD) if options.dashboard else PROCESSES
    view = _view(setup, headless)
    with contextlib.closing(view), Supervisor(setup.config_file, setup.folder / "logs", specs) as supervisor:
        supervisor.start(stage=0)
        run = Run(options, setup, supervisor, view, stopping)
        result = run.drive()
    run.close()
    return result


def _view(setup: DemoSetup, headless: bool) -> View:
    from hil_gateway.demo.view import LiveView, PlainView
    from hil_gateway.track import load_track

    if headless or not sys.stderr.isatty():
        return PlainView()
    return LiveView(load_track(setup.config.track))
