"""`hil recorder run`: the recorder as a process of its own."""

from __future__ import annotations

import datetime as dt
from pathlib import Path
from typing import Annotated

import typer

from hil_gateway.settings.gateway import PERIOD_S

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)


@app.callback()
def _group() -> None:
    """Raw frames and topics into one MCAP file."""


@app.command()
def run(config_file: Annotated[Path | None, typer.Option("--config", help="TOML file")] = None) -> None:
    """Record until interrupted (Ctrl-C or SIGTERM ends with a complete file)."""
    from hil_gateway.bus.zenoh_bus import open_bus
    from hil_gateway.can_link import open_link
    from hil_gateway.config import load_config
    from hil_gateway.process.clock import NS_PER_S, SystemClock, wall_offset_ns
    from hil_gateway.process.lifecycle import StopRequest
    from hil_gateway.process.writable import check_folder
    from hil_gateway.session.files.format import session_metadata
    from hil_gateway.session.files.writer import SessionWriter
    from hil_gateway.session.recorder import Recorder, session_path

    config = load_config(config_file)
    check_folder(Path(config.recorder.folder), option="recorder.folder")
    stopping = StopRequest()
    link, bus, clock = open_link(config.can), open_bus(config.zenoh, "recorder"), SystemClock()
    started = dt.datetime.now(dt.UTC).isoformat(timespec="seconds").replace("+00:00", "Z")
    path = session_path(config.recorder, started)
    metadata = session_metadata(config, path.stem, link.kind, started)
    rotate, keep_free = config.recorder.rotate_bytes, config.recorder.min_free_bytes
    writer = SessionWriter(path, metadata, rotate, keep_free, attached=config.car.files())
    sent, channel = config.car.codec.sent_by("computer"), metadata["channel"]
    recorder = Recorder(config.recorder, bus, link, writer, wall_offset_ns(), sent=sent, channel=channel)
    while not stopping():
        now_ns = clock.now_ns()
        recorder.step(now_ns)
        clock.sleep_until(now_ns + int(PERIOD_S * NS_PER_S))
    recorder.close(clock.now_ns())
    link.close()
    bus.close()
