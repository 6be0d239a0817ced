"""`hil season`: many days of recordings as one page of trends."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hil_gateway.process.figures import print_json

PAGE = "season.html"


def season(
    folder: Annotated[Path, typer.Argument(help="folder of days, each a folder of recordings")],
    out: Annotated[Path | None, typer.Option(help="page to write (default: season.html in the folder)")] = None,
    scheduler: Annotated[
        str, typer.Option(help="address of a Dask scheduler whose workers see the folder; empty: this computer")
    ] = "",
    as_json: Annotated[bool, typer.Option("--json", help="the season as JSON on standard output")] = False,
) -> None:
    """Write the page of a season: tyres, effects, lap times, stops over its sessions, and where they changed."""
    from hil_gateway.cli.track_day.reading import side_by_side
    from hil_gateway.dashboard.day.season_page import page
    from hil_gateway.process.writable import check_file
    from hil_gateway.session.day.index import read_day
    from hil_gateway.session.day.season import season as season_of

    target = out or folder / PAGE
    if not as_json and folder.is_dir():
        check_file(target)
    day = read_day(folder, side_by_side(scheduler))
    found = season_of(day)
    if as_json:
        print_json(found)
        return
    target.write_text(page(found, day["sessions"]), encoding="utf-8")
    typer.echo(f"{found['sessions']} sessions, {len(found['changes'])} changes; page {target}")


app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
app.command()(season)
