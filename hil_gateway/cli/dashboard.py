"""`hil dashboard run`: the page as a process of its own."""

from __future__ import annotations

import socket
from pathlib import Path
from typing import Annotated

import typer

from hil_gateway.process.errors import InputError

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None, no_args_is_help=True)


@app.callback()
def _group() -> None:
    """Read-only live page."""


@app.command()
def run(
    config_file: Annotated[Path | None, typer.Option("--config", help="TOML file")] = None,
    port: Annotated[int | None, typer.Option(help="TCP port (default: dashboard.port)")] = None,
) -> None:
    """Serve the page until interrupted."""
    import uvicorn

    from hil_gateway.bus.zenoh_bus import open_bus
    from hil_gateway.config import load_config
    from hil_gateway.dashboard.feed import Feed, track_outline
    from hil_gateway.dashboard.server import create_app
    from hil_gateway.process.clock import SystemClock
    from hil_gateway.track.loading import load_track

    config = load_config(config_file, {} if port is None else {"dashboard.port": port})
    page = config.dashboard
    listener = _listen(page.host, page.port)
    bus, clock = open_bus(config.zenoh, "dashboard"), SystemClock()
    feed = Feed(bus)
    app_ = create_app(lambda: feed.snapshot(clock.now_ns()), track_outline(load_track(config.track)), 1 / page.rate_hz)
    server = uvicorn.Server(uvicorn.Config(app_, log_level="warning", lifespan="off", timeout_graceful_shutdown=1))
    typer.echo(f"dashboard: http://{page.host}:{page.port}/", err=True)
    try:
        server.run(sockets=[listener])
    except KeyboardInterrupt:
        pass  # uvicorn has ended in order, and raises the signal again afterwards
    finally:
        bus.close()


def _listen(host: str, port: int) -> socket.socket:
    try:
        return socket.create_server((host, port))
    except OSError as error:
        reason = f"{host}:{port} cannot be used: {error.strerror}"
        raise InputError(f"dashboard: {reason}; set dashboard.port to another one") from None
