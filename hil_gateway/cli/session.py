"""`hil session`: info, recover, export, import, replay; list, view and compare are in `session_look`."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Mapping
from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from hil_gateway.cli import session_look
from hil_gateway.process.errors import EXIT_FAILURE, InputError
from hil_gateway.process.figures import print_json, printable
from hil_gateway.process.writable import check_file

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None, no_args_is_help=True)

SessionFiles = Annotated[list[Path], typer.Argument(help="recorded .mcap files")]
Sessions = Annotated[list[Path], typer.Argument(help="recorded .mcap files, or folders of them")]
OneSession = Annotated[Path, typer.Argument(help="a recorded .mcap file")]
AsJson = Annotated[bool, typer.Option("--json", help="one JSON object on standard output")]
Out = Annotated[Path | None, typer.Option("--out", help="file to write")]


class ExportFormat(StrEnum):
    """What a session can be exported to."""

    CSV = "csv"
    PARQUET = "parquet"
    CANDUMP = "candump"
    SIGNALS = "signals"
    MOTEC = "motec"
    ROS2 = "ros2"


SUFFIXES = {ExportFormat.CSV: ".csv", ExportFormat.PARQUET: ".parquet", ExportFormat.CANDUMP: ".log"}
SIGNAL_SUFFIXES = (".csv", ".parquet")
ENDINGS = {
    **SUFFIXES,
    ExportFormat.SIGNALS: "_signals.csv",
    ExportFormat.MOTEC: "_motec.csv",
    ExportFormat.ROS2: "_ros2.mcap",
}
"""of the file's name where nobody gives one"""


class Target(StrEnum):
    """Where a session can be played to."""

    ZENOH = "zenoh"
    CAN = "can"
    BOTH = "both"


@app.callback()
def _group() -> None:
    """Recordings: what is in them, and what can be made of them."""


@app.command()
def info(files: Sessions, as_json: AsJson = False) -> None:
    """Say what a session holds, and whether it is whole. Exit 1 when a part of it is corrupt.

    Files that a restarted recorder went on with are read as one run.
    """
    from hil_gateway.car.car import load_car
    from hil_gateway.session.overview.info import describe, session_infos

    car = load_car()
    infos = [info for path in files for info in session_infos(path, car)]
    if as_json:
        print_json(infos[0] if len(infos) == 1 else {"sessions": infos})
    else:
        print("\n".join(printable(line) for one in infos for line in describe(one)))
    if any(one["corrupt"] for one in infos):
        raise typer.Exit(EXIT_FAILURE)


@app.command()
def recover(file: OneSession, out: Out = None, as_json: AsJson = False) -> None:
    """Write a complete file from whatever a damaged one still holds."""
    from hil_gateway.session.files.output import output_path
    from hil_gateway.session.files.recover import recover as recover_session

    target = out or output_path(file, f"_recovered{file.suffix}")
    check_file(target, (file,))
    done = recover_session(file, target)
    values = {"messages": done.messages, "damage": done.damage, "path": str(target)}
    _report(values, f"{done.messages} messages recovered to {target}", as_json)


@app.command()
def export(
    file: OneSession,
    format: Annotated[
        ExportFormat | None,
        typer.Option("--format", help="drive log: csv, parquet, motec; raw frames: candump; both: ros2; signals"),
    ] = None,
    out: Out = None,
    as_json: AsJson = False,
) -> None:
    """Write a drive log, the raw frames, or every decoded signal."""
    from hil_gateway.session.exchange.formats import EXPORTS
    from hil_gateway.session.files.output import output_path

    chosen = format or _format_of(out)
    suffixes = SIGNAL_SUFFIXES if chosen is ExportFormat.SIGNALS else (Path(f"_{ENDINGS[chosen]}").suffix,)
    target = out or output_path(file, ENDINGS[chosen])
    check_file(target, (file,))
    if target.is_file() and target.suffix not in suffixes:
        reason = f"there already and no {' or '.join(suffixes)} file, never written over"
        raise InputError(f"{target}: {reason}; choose another --out")
    done = EXPORTS[chosen](file, target)
    values = {"rows": done.rows, "left_out": done.left_out, "damage": done.damage, "path": str(target)}
    _report(values, f"{done.rows} rows written to {target}", as_json)


def _format_of(out: Path | None) -> ExportFormat:
    """What the ending of `out` says; CSV without a name, and for a device or a pipe.

    Raises:
        InputError: an ending of no known format.
    """
    if out is None or (out.exists() and not out.is_file()):
        return ExportFormat.CSV
    for name, suffix in SUFFIXES.items():
        if out.suffix == suffix:
            return name
    known = ", ".join(f"{suffix} ({name.value})" for name, suffix in SUFFIXES.items())
    ending = f"the ending {out.suffix} names no format" if out.suffix else "no ending that names the format"
    raise InputError(f"{out}: {ending}; known: {known}; choose one of them, or give --format")


@app.command(name="import")
def import_(
    file: Annotated[Path, typer.Argument(help="a CAN log of any kind, or a ROS 2 bag with can_msgs/Frame")],
    *,
    out: Out = None,
    channel: Annotated[str | None, typer.Option(help="only this bus of a log that holds several")] = None,
    estimate: Annotated[bool, typer.Option("--estimate", help="run gateway and estimator over the frames")] = False,
    config_file: Annotated[Path | None, typer.Option("--config", help="TOML file: car, track, origin")] = None,
    as_json: AsJson = False,
) -> None:
    """Make a session of a log of raw CAN frames; with --estimate one that identify and diagnose can work on."""
    from hil_gateway.car.car import load_car
    from hil_gateway.session.exchange.importer import import_log
    from hil_gateway.session.files.output import output_path

    target = out or output_path(file, ".mcap")
    if out is None and target.exists():
        raise InputError(f"{target}: there already, perhaps the recording the log was made of; name a file with --out")
    check_file(target, (file,))
    if estimate:
        from hil_gateway.session.exchange.estimate import import_and_estimate

        values, text = import_and_estimate(file, target, channel, config_file)
        _report(values, text, as_json)
        return
    done = import_log(file, target, load_car(), channel)
    values = {"frames": done.frames, "left_out": done.left_out, "notes": done.notes, "path": str(target)}
    _report(values, f"{done.frames} frames written to {target}", as_json)


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
    """Play sessions back. On Zenoh it takes the gateway's place; on CAN only frames of a car are sent.

    Exit 1 when the interface did not take every frame.
    """
    from hil_gateway.config import load_config
    from hil_gateway.session.playback.player import play
    from hil_gateway.session.playback.replay import DEFAULT_TOPICS

    if not 0 <= speed < float("inf"):
        raise InputError(f"--speed {speed} must be 0 (as fast as possible) or a positive factor")
    topics = () if to is Target.CAN else tuple(topic or DEFAULT_TOPICS)
    played = play(files, load_config(config_file), topics, to is not Target.ZENOH, speed)
    text = f"{played.items} recorded items played: {played.messages} messages, {played.frames} frames sent"
    _report(asdict(played), text, as_json)
    if played.refused:
        print(f"hil: {played.refused} frames were not sent: interface down, or --speed too high", file=sys.stderr)
        raise typer.Exit(EXIT_FAILURE)


def _of_the_estimator(name: str) -> Any:
    """A command that lives with the drive logs, which this package does not import; by its name, as in `main`."""
    return getattr(importlib.import_module(f"estimator.cli.{name}"), name)


app.command()(_of_the_estimator("columns"))
app.command()(session_look.view)
app.command()(session_look.compare)
app.command(name="list")(session_look.list_)


def _report(values: Mapping[str, Any], text: str, as_json: bool) -> None:
    """What was done on standard output; what was left out or not readable on standard error."""
    for place in values.get("damage", ()):
        print(f"hil: not readable: {place}", file=sys.stderr)
    for reason, number in values.get("left_out", {}).items():
        print(f"hil: left out: {reason}, {number} times", file=sys.stderr)
    for note in values.get("notes", ()):
        print(f"hil: {note}", file=sys.stderr)
    if as_json:
        print_json(values)
    else:
        print(text)
