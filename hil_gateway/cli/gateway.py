"""`hil gateway`: the process, the bring-up check, and what a person can ask of a running gateway."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from hil_gateway.bus.interface import Subscription
from hil_gateway.bus.messages import FailsafeAction, GatewayStatus, OperatorAction
from hil_gateway.config import ZenohConfig, load_config
from hil_gateway.process.errors import EXIT_FAILURE, InputError

app = typer.Typer(no_args_is_help=True, help="CAN to vehicle state, commands to CAN; bring-up check.")

ConfigOption = Annotated[Path | None, typer.Option("--config", help="TOML configuration")]
ANSWER_S = 3.0
"""How long a request waits for the gateway's status."""
REPEAT_S = 0.1
"""A request is sent again until it is answered; the gateway knows the second delivery of the same one."""
EXPECTED = {
    OperatorAction.ARM: (FailsafeAction.DRIVE,),
    OperatorAction.DISARM: (FailsafeAction.SILENT, FailsafeAction.CONTROLLED_STOP),
    OperatorAction.STOP: (FailsafeAction.CONTROLLED_STOP, FailsafeAction.EMERGENCY_STOP, FailsafeAction.SILENT),
    OperatorAction.EMERGENCY: (FailsafeAction.EMERGENCY_STOP, FailsafeAction.SILENT),
}
"""Actions after which a request counts as answered."""


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


@app.command()
def arm(config: ConfigOption = None) -> None:
    """Ask the gateway to send actuator commands. Says what is missing when it refuses."""
    _request(config, OperatorAction.ARM)


@app.command()
def disarm(config: ConfigOption = None) -> None:
    """Stop sending actuator commands. At once when standing, after a controlled stop when moving."""
    _request(config, OperatorAction.DISARM)


@app.command()
def stop(config: ConfigOption = None) -> None:
    """Controlled stop; latches."""
    _request(config, OperatorAction.STOP)


@app.command()
def emergency(config: ConfigOption = None) -> None:
    """Emergency stop; latches."""
    _request(config, OperatorAction.EMERGENCY)


def _request(config: Path | None, action: OperatorAction) -> None:
    """Send one request and wait for what the gateway says it does."""
    from hil_gateway.bus import topics
    from hil_gateway.bus.messages import OperatorCommand
    from hil_gateway.bus.zenoh_bus import open_bus

    reached = _address(load_config(config).zenoh, config)
    typer.echo(f"to the {reached.name}", err=True)
    bus = open_bus(reached.zenoh, "operator")
    try:
        statuses = bus.subscribe(topics.GATEWAY_STATUS)
        if _wait(statuses) is None:
            raise InputError(f"no gateway answers at {', '.join(reached.zenoh.connect)}; {reached.remedy}")
        now = time.monotonic_ns()
        message = OperatorCommand(stamp_ns=now, seq=now // 1000, source=f"cli-{os.getpid()}", action=action)
        answer = _wait(statuses, EXPECTED[action], lambda: bus.publish(topics.OPERATOR, message))
    finally:
        bus.close()
    if answer is None or answer.action not in EXPECTED[action]:
        typer.echo(f"refused: {action.value}: {_why(answer)}", err=True)
        raise typer.Exit(EXIT_FAILURE)
    typer.echo(f"{answer.action.value}{': ' + answer.cause if answer.cause else ''}")


@dataclass(frozen=True)
class Address:
    """Where a request goes, in words, and what to do when nobody answers there."""

    zenoh: ZenohConfig
    name: str
    remedy: str


def _address(asked: ZenohConfig, config: Path | None) -> Address:
    """The configured gateway where one is named, else the one of this user that was started last, else the default.

    Raises:
        InputError: it asks for certificates, and nobody has said where those of the operator are.
    """
    from hil_gateway.process.running import running_gateways

    found = running_gateways()
    endpoints = ", ".join(asked.connect)
    if config is not None or asked != ZenohConfig():
        return Address(asked, f"configured gateway ({endpoints})", "is zenoh.connect that of the gateway?")
    if not found:
        remedy = "no gateway of this user runs here: start `hil gateway run`, or name one with --config FILE"
        return Address(asked, f"default gateway ({endpoints})", remedy)
    last, *others = found
    if last.secured:
        raise InputError(f"the {last} asks for certificates; give --config FILE with the operator's (zenoh.extra)")
    for other in others:
        typer.echo(f"not to the {other}: started earlier; --config FILE names one", err=True)
    return Address(last.zenoh, str(last), "it runs but is silent: end its process")


def _why(answer: GatewayStatus | None) -> str:
    """What keeps the gateway from doing it."""
    if answer is None:
        return "no answer"
    state = f"the gateway stays in {answer.action.value}{': ' + answer.cause if answer.cause else ''}"
    return ", ".join(answer.missing_for_arming) or state


def _wait(
    statuses: Subscription[GatewayStatus],
    actions: tuple[FailsafeAction, ...] | None = None,
    request: Callable[[], None] = lambda: None,
) -> GatewayStatus | None:
    """Newest status within `ANSWER_S`; with `actions`, waits for one of them from the second status on."""
    newest: GatewayStatus | None = None
    seen = 0
    start = asked = time.monotonic()
    request()
    while (now := time.monotonic()) < start + ANSWER_S:
        for status in statuses.poll(time.monotonic_ns()):
            newest = status
            seen += 1
        if newest is not None and (actions is None or (seen > 1 and newest.action in actions)):
            return newest
        if now >= asked + REPEAT_S:
            asked = now
            request()
        time.sleep(0.02)
    return newest
