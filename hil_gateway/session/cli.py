"""`hil session`: info, recover, export, import, replay."""

from __future__ import annotations

import json
import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from hil_gateway.errors import EXIT_FAILURE, InputError

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None, no_args_is_help=True)

SessionFiles = Annotated[list[Path], typer.Argument(help="recorded .mcap files")]
OneSession = Annotated[Path, typer.Argument(help="a recorded .mcap file")]
AsJson = Annotated[bool, typer.Option("--json", help="one JSON object on standard output")]
Out = Annotated[Path | None, typer.Option("--out", help="file to write")]


class Format(StrEnum):
    """What a session can be exported to."""

    CSV = "csv"
    PARQUET = "parquet"
    CANDUMP = "candump"


SUFFIXES = {Format.CSV: ".csv", Format.PARQUET: ".parquet", Format.CANDUMP: ".log"}


class Target(StrEnum):
    """Where a session can be played to."""

    ZENOH = "zenoh"
    CAN = "can"
    BOTH = "both"


@app.callback()
def _group() -> None:
    """Recordings: what is in them, and what can be made of them."""


@app.command()
def info(files: SessionFiles, as_json: AsJson = False) -> None:
    """Say what a session holds, and whether it is whole. Exit 1 when a part of it is corrupt."""
    from hil_gateway.session.info import describe, session_info

    infos = [session_info(path) for path in files]
    if as_json:
        print(json.dumps(infos[0] if len(infos) == 1 else {"sessions": infos}))
    else:
        print("\n".join(line for one in infos for line in describe(one)))
    if any("corrupt" in damage for one in infos for damage in one["damage"]):
        raise typer.Exit(EXIT_FAILURE)


@app.command()
def recover(file: OneSession, out: Out = None, as_json: AsJson = False) -> None:
    """Write a complete file from whatever a damaged one still holds."""
    from hil_gateway.session.recover import recover as recover_session

    target = out or file.with_stem(f"{file.stem}_recovered")
    count, reader = recover_session(file, target)
    damage = [str(d) for d in reader.damage]
    for line in damage:
        print(f"{file}: {line}", file=sys.stderr)
    _report(
        {"messages": count, "damage": damage, "path": str(target)}, f"{count} messages recovered to {target}", as_json
    )


@app.command()
def export(
    file: OneSession,
    format: Annotated[
        Format | None,
        typer.Option("--format", help="drive log as csv or parquet, or raw frames (default: as --out says, else csv)"),
    ] = None,
    out: Out = None,
    as_json: AsJson = False,
) -> None:
    """Write a drive log (csv, parquet) or the raw frames (candump log)."""
    from hil_gateway.session.export import EXPORTS

    by_suffix = {suffix: name for name, suffix in SUFFIXES.items()}
    chosen = format or by_suffix.get(out.suffix if out else "", Format.CSV)
    target = out or file.with_suffix(SUFFIXES[chosen])
    count = EXPORTS[chosen](file, target)
    _report({"rows": count, "path": str(target)}, f"{count} rows written to {target}", as_json)


@app.command(name="import")
def import_(
    file: Annotated[Path, typer.Argument(help="a candump .log, Vector .asc or .blf file")],
    out: Out = None,
    as_json: AsJson = False,
) -> None:
    """Make a session of a log of raw CAN frames."""
    from hil_gateway.session.importer import import_log

    target = out or file.with_suffix(".mcap")
    count = import_log(file, target)
    _report({"frames": count, "path": str(target)}, f"{count} frames written to {target}", as_json)


@app.command()
def replay(
    files: SessionFiles,
    *,
    to: Annotated[Target, typer.Option(help="where to")] = Target.ZENOH,
    speed: Annotated[float, typer.Option(help="1: real time, 2: twice as fast, 0: as fast as possible")] = 1.0,
    topic: Annotated[list[str] | None, typer.Option(help="only these topics (default: all but commands)")] = None,
    config_file: Annotated[Path | None, typer.Option("--config", help="TOML file")] = None,
    as_json: AsJson = False,
) -> None:
    """Play sessions back. On Zenoh it takes the gateway's place; on CAN only frames of a car are sent."""
    from hil_gateway.can_link import open_link
    from hil_gateway.clock import SystemClock
    from hil_gateway.config import load_config
    from hil_gateway.session import replay as r
    from hil_gateway.session.reader import Item
    from hil_gateway.zenoh_bus import HUB, open_bus

    if not 0 <= speed < float("inf"):
        raise InputError(f"--speed {speed} must be 0 (as fast as possible) or a positive factor")
    config = load_config(config_file)
    bus = open_bus(config.zenoh, HUB) if to is not Target.CAN else None
    link = open_link(config.can) if to is not Target.ZENOH else None
    sends = [r.to_bus(bus, topic or r.DEFAULT_TOPICS)] if bus else []
    sends += [r.to_can(link, r.ids_from_car())] if link else []

    def send(item: Item) -> None:
        for one in sends:
            one(item)

    try:
        count = r.replay(r.read_all(files), send, SystemClock(), speed)
    finally:
        for end in (bus, link):
            if end:
                end.close()
    _report({"items": count}, f"{count} recorded items played", as_json)


def _report(values: dict[str, object], text: str, as_json: bool) -> None:
    print(json.dumps(values) if as_json else text)
