"""`hil day`: a folder of recordings as one page; chosen runs as one file for somebody else."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from hil_gateway.cli.groups import Group
from hil_gateway.process.figures import print_json

SHOW = "show"
PAGE = "day.html"


class _ShowFirst(Group):
    """`hil day FOLDER` is `hil day show FOLDER`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        if args and args[0] not in self.commands and not args[0].startswith("-"):
            args = [SHOW, *args]
        return super().parse_args(ctx, args)


app = typer.Typer(cls=_ShowFirst, no_args_is_help=True, help="A day at the track: `hil day FOLDER` makes its page.")
Folder = Annotated[Path, typer.Argument(help="folder of recordings, and of folders with recordings")]
AsJson = Annotated[bool, typer.Option("--json", help="the day as JSON on standard output")]


@app.command(name=SHOW)
def show(
    folder: Folder,
    out: Annotated[Path | None, typer.Option(help="page to write (default: day.html in the folder)")] = None,
    as_json: AsJson = False,
) -> None:
    """Write the page of a day: runs, laps, tyres, stops, notes, models. The index is made of the recordings alone."""
    from hil_gateway.cli.track_day.reading import side_by_side
    from hil_gateway.session.day.index import read_day

    day = read_day(folder, side_by_side())
    if as_json:
        print_json(day)
        return
    _write_page(day, out or folder / PAGE)


@app.command()
def compare(
    folder: Folder,
    laps: Annotated[list[str], typer.Argument(help="two laps as the page numbers them, as 1.3 2.5")],
    out: Annotated[Path, typer.Option(help="page to write")] = Path("compare.html"),
) -> None:
    """Write one page with two laps of the day over distance."""
    from hil_gateway.cli.session_look import compare as compare_sessions
    from hil_gateway.cli.track_day.reading import side_by_side
    from hil_gateway.process.errors import InputError
    from hil_gateway.session.day.index import lap_place, read_day

    if len(laps) != 2:
        raise InputError("two laps, as the page numbers them: `hil day compare FOLDER 1.3 2.5`")
    day = read_day(folder, side_by_side())
    (first, one), (second, other) = (lap_place(folder, day, lap) for lap in laps)
    compare_sessions(first, second, laps=f"{one},{other}", track="", out=out, as_json=False)


@app.command()
def share(
    folder: Folder,
    sessions: Annotated[str, typer.Option(help="which sessions, as 1,3 (default: all)")] = "",
    out: Annotated[Path, typer.Option(help="file to write")] = Path("day.zip"),
) -> None:
    """Put chosen sessions into one file that opens on another computer; personal paths are left out."""
    from hil_gateway.session.day.share import share_day

    typer.echo(share_day(folder, sessions, out))


@app.command(name="open")
def open_(
    file: Annotated[Path, typer.Argument(help="file that `hil day share` wrote")],
    out: Annotated[Path | None, typer.Option(help="folder to open it in (default: named as the file)")] = None,
) -> None:
    """Unpack a shared day and write its page."""
    from hil_gateway.cli.track_day.reading import side_by_side
    from hil_gateway.session.day.index import read_day
    from hil_gateway.session.day.share import open_day

    folder = open_day(file, out or file.with_suffix(""))
    _write_page(read_day(folder, side_by_side()), folder / PAGE)


def _write_page(day: dict[str, Any], out: Path) -> None:
    from hil_gateway.dashboard.day.page import page
    from hil_gateway.process.writable import check_file

    check_file(out)
    out.write_text(page(day), encoding="utf-8")
    typer.echo(f"{len(day['sessions'])} sessions; page {out}")
