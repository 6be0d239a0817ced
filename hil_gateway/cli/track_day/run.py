"""`hil run`: what a run is to be, begun, brought in and gone on with."""

from __future__ import annotations

import os
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hil_gateway.process.errors import EXIT_FAILURE, InputError

if TYPE_CHECKING:
    from hil_gateway.bus.track_day.run import RunAction, RunPlan, RunStatus

app = typer.Typer(
    no_args_is_help=True, help="Runs: laps, caps on speed and grip, in lap. Arming stays `hil gateway arm`."
)
ConfigOption = Annotated[Path | None, typer.Option("--config", help="TOML configuration")]


@app.command()
def start(
    file: Annotated[Path, typer.Argument(help="run.toml: laps, speed, load_use, box, stop_at, tyres, fuel_kg, notes")],
    config: ConfigOption = None,
) -> None:
    """Begin a run from where the car stands."""
    from hil_gateway.bus.track_day.run import RunAction, read_run

    _ask(config, RunAction.START, read_run(file))


@app.command(name="in")
def in_(config: ConfigOption = None) -> None:
    """Make the lap under way the in lap: slow down, and stop where the run says."""
    from hil_gateway.bus.track_day.run import RunAction

    _ask(config, RunAction.IN)


@app.command()
def abort(config: ConfigOption = None) -> None:
    """Brake and stop here; the run is not clean then."""
    from hil_gateway.bus.track_day.run import RunAction

    _ask(config, RunAction.ABORT)


@app.command(name="next")
def next_(config: ConfigOption = None) -> None:
    """Begin the last run again; caps have risen if it was clean."""
    from hil_gateway.bus.track_day.run import RunAction

    _ask(config, RunAction.NEXT)


@app.command()
def show(config: ConfigOption = None) -> None:
    """Say where in its run the car is."""
    _ask(config, None)


def _ask(config: Path | None, action: RunAction | None, plan: RunPlan | None = None) -> None:
    """Send a request, and print what the planner makes of it."""
    from hil_gateway.bus import topics
    from hil_gateway.bus.track_day.run import RunRequest
    from hil_gateway.bus.zenoh_bus import open_bus
    from hil_gateway.config import load_config
    from hil_gateway.gateway.asking import address, wait

    reached, now = address(load_config(config).zenoh, config), time.monotonic_ns()
    bus = open_bus(reached.zenoh, "operator")
    try:
        answers = bus.subscribe(topics.RUN)
        if wait(answers, lambda _: True) is None:
            raise InputError(f"no planner answers at {', '.join(reached.zenoh.connect)}: `hil planner run`")
        send, source = None, f"cli-{os.getpid()}"
        if action is not None:
            request = RunRequest(stamp_ns=now, seq=now // 1000, source=source, action=action, plan=plan)
            send = partial(bus.publish, topics.RUN_REQUEST, request)
        answer = wait(answers, lambda status: action is None or status.answered == source, send)
    finally:
        bus.close()
    if answer is None or (action is not None and answer.answered != source):
        raise InputError("the planner does not answer the request: is it held up?")
    if action is not None and answer.refused:
        typer.echo(f"refused: {answer.refused}", err=True)
        raise typer.Exit(EXIT_FAILURE)
    typer.echo(described(answer))


def described(status: RunStatus) -> str:
    """Where the car is, in one line."""
    if status.plan is None:
        return "no run: no caps hold but those of the configuration" + (f"; {status.said}" if status.said else "")
    lap = f" lap {status.lap} of {status.plan.laps}" if status.phase == "flying" else ""
    where = f"run {status.number} ({status.plan.name}): {status.phase.value}{lap}, caps {status.caps or 'none'}"
    reasons = "; ".join(text for text in (status.caps_from, status.said) if text)
    return f"{where}; {reasons}"
