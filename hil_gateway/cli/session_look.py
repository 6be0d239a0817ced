"""`hil session list`, `view` and `compare`: recordings to look at."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from hil_gateway.process.errors import InputError
from hil_gateway.process.figures import lap_time, print_json

LOOPBACK = "127.0.0.1"
AsJson = Annotated[bool, typer.Option("--json", help="one JSON object on standard output")]
TrackFile = Annotated[str, typer.Option("--track", help="track file or name (default: the one it was recorded on)")]


def view(
    file: Annotated[Path, typer.Argument(help="a recorded .mcap file; of a folder, and of those in it, the newest")],
    port: Annotated[int, typer.Option(help="TCP port; 0: any free one", min=0, max=65535)] = 8025,
    track: TrackFile = "",
    lap_limit: Annotated[
        float | None, typer.Option(min=1.0, help="least lap time of this car here, s: laps are shown over it")
    ] = None,
) -> None:
    """Show a recording on the live page, with a bar to move in it. Serves on loopback until interrupted."""
    from hil_gateway.dashboard.recording import Recording, create_app
    from hil_gateway.dashboard.server import listen, serve
    from hil_gateway.session.files.configuration import recorded_config
    from hil_gateway.session.run import newest_in
    from hil_gateway.track.loading import load_track

    listener = listen(LOOPBACK, port)
    file = newest_in(file) if file.is_dir() else file
    config = recorded_config(file)
    course = load_track(track or config.track)
    typer.echo(f"reading {file}", err=True)
    recording = Recording(file, course, config)
    typer.echo(f"http://{LOOPBACK}:{listener.getsockname()[1]}/  (Ctrl-C ends)", err=True)
    serve(create_app(recording, course, config, lap_limit), listener)


def compare(
    first: Annotated[Path, typer.Argument(help="a recorded .mcap file")],
    second: Annotated[Path, typer.Argument(help="another one, or the same")],
    *,
    laps: Annotated[str, typer.Option("--lap", help="which lap of each, as 2,3 (default: the best of each)")] = "",
    track: TrackFile = "",
    out: Annotated[Path, typer.Option(help="page to write")] = Path("compare.html"),
    as_json: AsJson = False,
) -> None:
    """Write one page with two laps over distance: speed, pedals, steering, g, gap, lines."""
    from hil_gateway.dashboard.compare_page import page
    from hil_gateway.process.writable import check_file
    from hil_gateway.session.files.configuration import recorded_config
    from hil_gateway.session.overview.lap_table import read_lap, title
    from hil_gateway.track.loading import load_track

    numbers = _lap_numbers(laps)
    check_file(out, (first, second))
    course = load_track(track or recorded_config(first).track)
    tables = [read_lap(path, course, number) for path, number in zip((first, second), numbers, strict=True)]
    out.write_text(page(tables[0], tables[1], course), encoding="utf-8")
    times = [table.lap.time_s for table in tables]
    if as_json:
        print_json({"page": str(out), "lap_times_s": times, "laps": [table.lap.number for table in tables]})
    else:
        print("\n".join([*map(title, tables), f"page {out}"]))


def _lap_numbers(text: str) -> tuple[int | None, int | None]:
    """`2,3` -> (2, 3); empty: the best of each."""
    if not text:
        return None, None
    parts = text.split(",")
    if len(parts) != 2 or not all(part.strip().isdecimal() for part in parts):
        raise InputError(f"--lap {text}: two lap numbers with a comma between them, as 2,3")
    return int(parts[0]), int(parts[1])


def list_(
    folder: Annotated[Path, typer.Argument(help="folder of recordings")],
    as_json: AsJson = False,
) -> None:
    """One line a session of a folder: start, track, laps, best lap, stops, effects. An index makes it quick."""
    from hil_gateway.session.overview.catalogue import catalogue

    found = catalogue(folder, lambda text: typer.echo(text, err=True))
    if found.not_stored:
        typer.echo(f"hil: {found.not_stored}", err=True)
    if as_json:
        print_json({"sessions": found.entries, "read": found.read})
        return
    width = max((len(row["file"]) for row in found.entries), default=4)
    print(f"{'file':{width}}  {'started':20}  {'track':14}  laps       best  stops, effects")
    for row in found.entries:
        print(f"{row['file']:{width}}  {row['started']:20}  {_facts(row)}")


def _facts(row: dict[str, Any]) -> str:
    if reason := row.get("unreadable"):
        return f"not readable: {reason}"
    stops = f"stops: {len(row['stops'])} ({', '.join(dict.fromkeys(row['stops']))})" if row["stops"] else "no stop"
    effects = f"; effects {', '.join(row['effects'])}" if row["effects"] else ""
    suspected = f"; suspected {', '.join(row['suspected'])}" if row["suspected"] else ""
    best = lap_time(row["best_lap_s"])
    return f"{Path(row['track']).stem:14}  {row['laps']:4d}  {best:>9}  {stops}{effects}{suspected}"
