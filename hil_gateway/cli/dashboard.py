"""`hil dashboard`: the page as a process of its own."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None, no_args_is_help=True)


@app.callback()
def _group() -> None:
    """Read-only live page."""


@app.command()
def run(
    config_file: Annotated[Path | None, typer.Option("--config", help="TOML file")] = None,
    port: Annotated[int | None, typer.Option(help="TCP port (default: dashboard.port)")] = None,
    lap_limit: Annotated[
        float | None, typer.Option(min=1.0, help="least lap time of this car here, s: laps are shown over it")
    ] = None,
) -> None:
    """Serve the page until interrupted."""
    from hil_gateway.bus.zenoh_bus import open_bus
    from hil_gateway.config import load_config
    from hil_gateway.dashboard.feed import Feed, Live
    from hil_gateway.dashboard.server import create_app, listen, serve
    from hil_gateway.dashboard.setup import setup_of
    from hil_gateway.process.clock import SystemClock
    from hil_gateway.track.loading import load_track

    config = load_config(config_file, {} if port is None else {"dashboard.port": port})
    page, track = config.dashboard, load_track(config.track)
    listener = listen(page.host, page.port)
    bus, clock = open_bus(config.zenoh, "dashboard"), SystemClock()
    source = Live(Feed(bus, track, config), clock)
    typer.echo(f"dashboard: http://{page.host}:{page.port}/", err=True)
    try:
        serve(create_app(source, setup_of(track, config, limit_s=lap_limit), 1 / page.rate_hz), listener)
    finally:
        bus.close()
