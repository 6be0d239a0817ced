"""`hil track`: a track, drawn."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)


@app.callback()
def _group() -> None:
    """A track, drawn."""


@app.command()
def view(
    track: Annotated[str, typer.Argument(help="track file or name of a shipped track")],
    out: Annotated[Path | None, typer.Option(help="page to write (default: NAME.html here)")] = None,
) -> None:
    """Draw a track as one page: road, pit lane and boxes from above, bends, bank, height and width along a lap."""
    from hil_gateway.dashboard.track_page import page
    from hil_gateway.process.figures import figure
    from hil_gateway.process.writable import check_file
    from hil_gateway.track.loading import load_track

    read = load_track(track)
    target = out or Path(f"{read.name}.html")
    check_file(target)
    target.write_text(page(read), encoding="utf-8")
    typer.echo(f"{read.name}, {figure(read.length, 'm', 5)}; page {target}")
