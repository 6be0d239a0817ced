"""`hil joystick`: a person drives, through the gateway's limits."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(no_args_is_help=True, help="A joystick or wheel as a source of commands; its switch takes over.")
DeviceOption = Annotated[Path, typer.Argument(help="as /dev/input/by-id/...-event-joystick")]
SHOWN_S = 0.1


@app.command()
def run(
    device: DeviceOption,
    config: Annotated[Path | None, typer.Option("--config", help="configuration (TOML)")] = None,
) -> None:
    """Drive by hand while the switch is held; released, the gateway stops the car. Arming stays `hil gateway arm`."""
    from hil_gateway.config import load_config
    from hil_gateway.joystick.node import run as run_node

    run_node(load_config(config), device)


@app.command()
def check(device: DeviceOption) -> None:
    """Show axes (-1 to 1) and pressed buttons by name and code, until stopped: what `[joystick]` wants to know."""
    import time

    from hil_gateway.joystick.device import Device
    from hil_gateway.process.lifecycle import StopRequest

    opened, stopped = Device(device), StopRequest()
    while opened.read() and not stopped():
        axes = "  ".join(f"{name} {value:+.2f}" for name, value in opened.state.axes.items())
        buttons = ", ".join(map(str, sorted(opened.state.pressed))) or "none"
        typer.echo(f"\r{axes or 'move an axis'}; buttons {buttons}\x1b[K", nl=False)
        time.sleep(SHOWN_S)
    typer.echo()
