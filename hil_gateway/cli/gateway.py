"""`hil gateway`: the process, the bring-up check, and what a person can ask of a running gateway."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from hil_gateway.bus.interface import Bus, Subscription
from hil_gateway.bus.messages import GatewayStatus, OperatorAction
from hil_gateway.config import load_config
from hil_gateway.gateway.asking import address, wait
from hil_gateway.gateway.requests import REQUESTS
from hil_gateway.process.errors import EXIT_FAILURE, InputError

app = typer.Typer(no_args_is_help=True, help="CAN to vehicle state, commands to CAN; bring-up check.")

ConfigOption = Annotated[Path | None, typer.Option("--config", help="TOML configuration")]
CRANKED_S = 20.0
"""How long `arm --crank` waits until the car drives and nothing is missing: cranking takes some seconds."""


@app.command()
def run(config: ConfigOption = None) -> None:
    """Run the gateway process until SIGINT or SIGTERM."""
    from hil_gateway.gateway.node import run as run_node

    run_node(load_config(config))


@app.command()
def check(
    channel: Annotated[str | None, typer.Option(help="SocketCAN interface; without it the configured bus")] = None,
    seconds: Annotated[float, typer.Option(help="how long to listen")] = 5.0,
    as_json: Annotated[bool, typer.Option("--json", help="one JSON object on standard output")] = False,
    config: ConfigOption = None,
) -> None:
    """Bring-up: listen only. Say what is there, what is not, and what arming still needs."""
    from hil_gateway.gateway.check import run_check

    raise typer.Exit(run_check(load_config(config), channel, seconds, as_json))


@app.command(help=REQUESTS[OperatorAction.ARM].meaning)
def arm(
    config: ConfigOption = None,
    crank: Annotated[bool, typer.Option("--crank", help="crank first, unless that is done")] = False,
) -> None:
    """Ask for the engine, where wanted, and to drive."""
    _request(config, *([OperatorAction.CRANK] if crank else []), OperatorAction.ARM)


def _command(action: OperatorAction) -> Callable[..., None]:
    def command(config: ConfigOption = None) -> None:
        _request(config, action)

    return command


for _action, _row in REQUESTS.items():
    if _action is not OperatorAction.ARM:
        app.command(_action.value, help=_row.meaning)(_command(_action))


def _request(config: Path | None, *actions: OperatorAction) -> None:
    """Send one request after the other, each when the gateway has done what was asked before."""
    from hil_gateway.bus import topics
    from hil_gateway.bus.zenoh_bus import open_bus

    reached = address(load_config(config).zenoh, config)
    typer.echo(f"to the {reached.name}", err=True)
    bus = open_bus(reached.zenoh, "operator")
    try:
        statuses = bus.subscribe(topics.GATEWAY_STATUS)
        if (before := wait(statuses, lambda status: True)) is None:
            raise InputError(f"no gateway answers at {', '.join(reached.zenoh.connect)}; {reached.remedy}")
        crank = REQUESTS[OperatorAction.CRANK]
        for action in actions:
            if action is OperatorAction.CRANK:
                wait(statuses, lambda status: not status.missing_for_crank or crank.done(status, before))
            elif len(actions) > 1:
                wait(statuses, lambda status: not status.missing_for_arming, seconds=CRANKED_S)
            _ask(bus, statuses, action, before)
    finally:
        bus.close()


def _ask(bus: Bus, statuses: Subscription[GatewayStatus], action: OperatorAction, before: GatewayStatus) -> None:
    """Send one request and wait for what the gateway says it does."""
    from hil_gateway.bus import topics
    from hil_gateway.bus.messages import OperatorCommand

    now = time.monotonic_ns()
    message = OperatorCommand(stamp_ns=now, seq=now // 1000, source=f"cli-{os.getpid()}", action=action)
    request = partial(bus.publish, topics.OPERATOR, message)
    row = REQUESTS[action]
    answer = wait(statuses, lambda status: row.done(status, before), request)
    if answer is None or not row.done(answer, before):
        typer.echo(f"refused: {action.value}: {_why(action, answer)}", err=True)
        raise typer.Exit(EXIT_FAILURE)
    typer.echo(row.answer(answer))


def _why(action: OperatorAction, answer: GatewayStatus | None) -> str:
    """What keeps the gateway from doing it."""
    from hil_gateway.gateway.check.arming import EXPLANATION

    if answer is None:
        return "no answer"
    if action is OperatorAction.TAKE_OVER:
        return f"only {answer.command_source or 'nobody'} sends commands"
    if action is OperatorAction.CRANK:
        return ", ".join(EXPLANATION.get(name, name) for name in answer.missing_for_crank)
    if action is OperatorAction.ARM and not (answer.missing_for_arming or answer.cause):
        return "it was not ready when it was asked, and is now: ask again"
    state = f"the gateway stays in {answer.action.value}{': ' + answer.cause if answer.cause else ''}"
    awaited = "" if answer.missing_for_crank else "; first `hil gateway crank`"
    advice = answer.advice
    missing = [f"{name}: {advice.get(name) or EXPLANATION.get(name, name)}" for name in answer.missing_for_arming]
    return ("\n  ".join(missing) or state) + awaited
