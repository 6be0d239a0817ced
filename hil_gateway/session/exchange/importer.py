"""Raw frames of a CAN log of any program -> session."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path

from hil_gateway.can_link.cdr import pack_frame
from hil_gateway.car.car import Car
from hil_gateway.process.errors import InputError
from hil_gateway.session.files.format import CAN_TOPIC, METADATA_SESSION, frame_source, software_version
from hil_gateway.session.files.output import output_file
from hil_gateway.session.files.writer import FLUSH_EVERY, SessionFile
from hil_gateway.session.logs.entry import LoggedFrame
from hil_gateway.session.logs.reading import Log, open_log

OTHER_CHANNEL = "frame of another channel"


@dataclass
class Imported:
    """What became of a log."""

    frames: int = 0
    left_out: Counter[str] = field(default_factory=Counter)
    """entries a recording has no place for, by kind"""
    notes: list[str] = field(default_factory=list)
    """what was wrong with the log, and what was done about it"""


def open_named(source: Path, car: Car) -> Log:
    """A log whose messages may be named as in the DBC.

    Raises:
        InputError: unreadable, or of no known kind.
    """
    return open_log(source, {message.name: number for number, message in car.codec.by_id.items()})


def import_log(source: Path, target: Path, car: Car, channel: str | None = None) -> Imported:
    """Write every classic CAN data and error frame of `source`, a log of `car`, to a new session.

    `channel` picks one of the buses of a log; without it the log must be of a single one.

    Raises:
        InputError: unreadable, unknown or empty log, several channels, `target` cannot be written.
    """
    log, count, sent = open_named(source, car), Imported(), car.codec.sent_by("computer")
    frames = _of_channel(log, channel)
    first = next(frames, None)
    if first is None:
        remedy = "" if channel else "; `hil identify` and `hil diagnose` take logs of the drive itself"
        raise InputError(f"{source}: holds no CAN frames{f' of channel {channel}' if channel else remedy}")
    metadata = _metadata(source, first.channel, car)
    with output_file(target, source) as path, SessionFile(path, metadata, attached=car.files()) as file:
        for entry in chain((first,), frames):
            if entry.channel != first.channel:
                both = f"{first.channel} and {entry.channel}"
                raise InputError(f"{source}: holds the channels {both}; choose one with --channel")
            count.frames += 1
            stamp_ns = entry.frame.stamp_ns
            data = pack_frame(entry.frame, stamp_ns, frame_source(entry.channel, entry.frame.id, sent))
            file.add(CAN_TOPIC, data, stamp_ns, stamp_ns, count.frames)
            if count.frames % FLUSH_EVERY == 0:
                file.flush()
    count.left_out, count.notes = log.left_out, log.notes
    return count


def _metadata(source: Path, channel: str, car: Car) -> dict[str, dict[str, str]]:
    session = {"name": source.stem, "imported_from": source.name, "channel": channel}
    config = json.dumps({"platform": car.platform})
    known = {"software": software_version(), "dbc_sha256": car.dbc_sha256, "config": config}
    return {METADATA_SESSION: {**session, **known}}


def _of_channel(log: Log, channel: str | None) -> Iterator[LoggedFrame]:
    """Frames of one bus; those of others are counted."""
    for entry in log.frames():
        if channel in (None, entry.channel):
            yield entry
        else:
            log.left_out[OTHER_CHANNEL] += 1
