"""`hil can monitor`: the bus in the terminal, decoded. Listens only."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hil_gateway.can_link import CanLink, open_link
from hil_gateway.can_link.monitor import FrameMonitor, FrameStream, cells, line, signals
from hil_gateway.car.car import load_car
from hil_gateway.config import load_config
from hil_gateway.process.clock import NS_PER_S, SystemClock
from hil_gateway.process.figures import print_json
from hil_gateway.process.lifecycle import StopRequest
from hil_gateway.session.exchange.importer import open_named
from hil_gateway.session.files.configuration import recorded_car
from hil_gateway.session.overview.bus_log import BusLog, read_buses

if TYPE_CHECKING:
    from rich.table import Table

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None, no_args_is_help=True)
REFRESH_S, PLAIN_S = 0.2, 1.0
"""between two pictures in a terminal, and between two blocks of plain lines"""


@app.callback()
def _group() -> None:
    """The CAN bus, decoded; nothing is sent."""


@app.command()
def monitor(
    file: Annotated[Path | None, typer.Argument(help="a CAN log of any kind, or a bag, instead of a live bus")] = None,
    *,
    channel: Annotated[
        str | None, typer.Option(help="SocketCAN interface, default: the configured bus; of a log: only this bus")
    ] = None,
    filters: Annotated[list[str] | None, typer.Option("--filter", help="part of an id, message or signal")] = None,
    seconds: Annotated[float, typer.Option(help="end after so long; 0: until interrupted", min=0)] = 0.0,
    config: Annotated[Path | None, typer.Option(help="configuration (TOML)")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="at the end, one JSON object on standard output")] = False,
) -> None:
    """Signals, rate, age and counter of every message; what has just changed stands out."""
    if file is not None:
        car = recorded_car([file])
        _show(read_buses(open_named(file, car), car.codec, filters or (), channel), as_json)
        return
    view = FrameMonitor(load_car().codec, filters or ())
    now_ns = _listen(_open(config, channel), view, seconds, quiet=as_json)
    if as_json:
        messages = [_tree(stream, now_ns) for stream in view.shown()]
        print_json({"frames": view.frames, "error_frames": view.errors, "messages": messages})


def _show(log: BusLog, as_json: bool) -> None:
    """A whole log, bus by bus."""
    for place in (*log.notes, *(f"left out: {reason}, {count} times" for reason, count in log.left_out.items())):
        print(f"hil: {place}", file=sys.stderr)
    if as_json:
        views = log.buses.items()
        messages = [{**_tree(s, view.last_ns), "bus": bus} for bus, view in views for s in view.shown()]
        counts = {bus: {"frames": view.frames, "error_frames": view.errors} for bus, view in views}
        frames, errors = (sum(count[key] for count in counts.values()) for key in ("frames", "error_frames"))
        told = {"left_out": log.left_out, "notes": log.notes}
        print_json({"frames": frames, "error_frames": errors, "buses": counts, "messages": messages, **told})
        return
    for bus, view in log.buses.items():
        print(f"{bus or 'bus without a name'}: {view.frames} frames, {view.errors} error frames")
        print("\n".join(line(stream, view.last_ns) for stream in view.shown()))


def _open(config: Path | None, channel: str | None) -> CanLink:
    can = load_config(config).can
    return open_link(can.model_copy(update={"channel": channel, "interface": "socketcan"}) if channel else can)


def _listen(link: CanLink, view: FrameMonitor, seconds: float, quiet: bool) -> int:
    """Show the bus until interrupted or `seconds` have passed; the time it ended."""
    stopped, clock = StopRequest(), SystemClock()
    show = _Quiet() if quiet else _Live() if sys.stdout.isatty() else _Plain()
    start_ns = due_ns = now_ns = clock.now_ns()
    try:
        while not stopped() and (seconds == 0 or now_ns - start_ns < seconds * NS_PER_S):
            view.take(link.receive(0.05))
            now_ns = clock.now_ns()
            if now_ns >= due_ns:
                due_ns = now_ns + int(show.period_s * NS_PER_S)
                show.update(view, now_ns)
    finally:
        show.close()
        link.close()
    return now_ns


class _Quiet:
    period_s = PLAIN_S

    def update(self, view: FrameMonitor, now_ns: int) -> None:
        """Nothing: the result comes at the end."""

    def close(self) -> None:
        """Nothing to end."""


class _Plain(_Quiet):
    """One line a message, every second."""

    def update(self, view: FrameMonitor, now_ns: int) -> None:
        for stream in view.shown():
            print(line(stream, now_ns))
        print(f"-- {view.frames} frames, {view.errors} error frames", flush=True)


class _Live(_Quiet):
    """A table that redraws itself at the size the terminal has."""

    period_s = REFRESH_S

    def __init__(self) -> None:
        from rich.live import Live

        self._live = Live(auto_refresh=False, vertical_overflow="ellipsis")
        self._live.start()

    def update(self, view: FrameMonitor, now_ns: int) -> None:
        self._live.update(table(view, now_ns), refresh=True)

    def close(self) -> None:
        self._live.stop()


def table(view: FrameMonitor, now_ns: int) -> Table:
    """The bus as a table; changed values are bold, late messages red."""
    from rich.table import Table
    from rich.text import Text

    drawn = Table(box=None, pad_edge=False, caption=f"{view.frames} frames, {view.errors} error frames; Ctrl-C ends")
    for name in ("id", "message", "rate", "age", "counter"):
        drawn.add_column(name, justify="left" if name in ("id", "message") else "right", no_wrap=True)
    drawn.add_column("signals", overflow="ellipsis", no_wrap=True)
    for stream in view.shown():
        words = Text()
        for text, changed in signals(stream, now_ns):
            words.append(f"{text}  ", style="bold yellow" if changed else "")
        drawn.add_row(*cells(stream, now_ns), words, style="red" if stream.late(now_ns) else "")
    return drawn


def _tree(stream: FrameStream, now_ns: int) -> dict[str, object]:
    return {
        "id": stream.frame_id, "name": stream.name, "count": stream.count, "rate_hz": stream.rate_hz,
        "age_s": (now_ns - stream.last_ns) / NS_PER_S, "counter_errors": stream.counter_errors,
        "late": stream.late(now_ns), "fault": stream.fault, "values": stream.values,
    }  # fmt: skip
