"""`hil session list`, `view` and `compare`: recordings to look at."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

LOOPBACK = "127.0.0.1"
AsJson = Annotated[bool, typer.Option("--json", help="one JSON object on standard output")]
TrackFile = Annotated[str, typer.Option("--track", help="track file or name (default: the one it was recorded on)")]


def view(
    file: Annotated[Path, typer.Argument(help="a recorded .mcap file")],
    port: Annotated[int, typer.Option(help="TCP port; 0: any free one", min=0, max=65535)] = 8025,
    track: TrackFile = "",
) -> None:
    """Show a recording on the live page, with a bar to move in it. Serves on loopback until interrupted."""
    from hil_gateway.dashboard.recording import Recording, create_app
    from hil_gateway.dashboard.server import listen, serve
    from hil_gateway.session.summary import recorded_config
    from hil_gateway.track.loading import load_track

    listener = listen(LOOPBACK, port)
    config = recorded_config(file)
    course = load_track(track or config.track)
    typer.echo(f"reading {file}", err=True)
    recording = Recording(file, course, config)
    typer.echo(f"http://{LOOPBACK}:{listener.getsockname()[1]}/  (Ctrl-C ends)", err=True)
    serve(create_app(recording, course, config), listener)
