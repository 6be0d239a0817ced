"""Raw frames of a candump, ASC or BLF log -> session."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any

from hil_gateway.can_link import EXTENDED_ID, Frame
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.process.errors import InputError
from hil_gateway.session.exchange.candump import (
    CUT_OFF,
    LONGER_FRAME,
    REMOTE_REQUEST,
    LeftOut,
    LoggedFrame,
    read_candump,
)
from hil_gateway.session.files.format import (
    CAN_TOPIC,
    METADATA_SESSION,
    dbc_hash,
    frame_source,
    pack_frame,
    software_version,
)
from hil_gateway.session.files.output import output_file
from hil_gateway.session.files.writer import FLUSH_EVERY, SessionFile
from hil_gateway.text_file import check_ends

CANDUMP = ".log"
SUFFIXES = (CANDUMP, ".asc", ".blf")
DLC_MAX = 8
LATEST_NS = (1 << 31) * NS_PER_S
"""what the recorded form of a frame can say: 2038"""


@dataclass
class Imported:
    """What became of a log."""

    frames: int = 0
    left_out: Counter[str] = field(default_factory=Counter)
    """entries a recording has no place for, by kind"""


def import_log(source: Path, target: Path, channel: str | None = None) -> Imported:
    """Write every classic CAN data and error frame of `source` to a new session.

    `channel` picks one of the buses of a log; without it the log must be of a single one.

    Raises:
        InputError: unreadable, unknown or empty log, several channels, `target` cannot be written.
    """
    count = Imported()
    entries = _recorded(source, channel, count)
    first = next(entries, None)
    if first is None:
        raise InputError(f"{source}: holds no CAN frames{f' of channel {channel}' if channel else ''}")
    with output_file(target, source) as path, SessionFile(path, _metadata(source, first.channel)) as file:
        for entry in chain((first,), entries):
            if entry.channel != first.channel:
                both = f"{first.channel} and {entry.channel}"
                raise InputError(f"{source}: holds the channels {both}; choose one with --channel")
            count.frames += 1
            stamp_ns = entry.frame.stamp_ns
            data = pack_frame(entry.frame, stamp_ns, frame_source(entry.channel, entry.frame.id))
            file.add(CAN_TOPIC, data, stamp_ns, stamp_ns, count.frames)
            if count.frames % FLUSH_EVERY == 0:
                file.flush()
    return count


def _metadata(source: Path, channel: str) -> dict[str, dict[str, str]]:
    session = {"name": source.stem, "imported_from": source.name, "channel": channel}
    return {METADATA_SESSION: {**session, "software": software_version(), "dbc_sha256": dbc_hash()}}


def _recorded(source: Path, channel: str | None, count: Imported) -> Iterator[LoggedFrame]:
    """What goes into the recording; the rest is counted."""
    for entry in _entries(source):
        if isinstance(entry, LeftOut):
            count.left_out[entry.kind] += 1
        elif channel in (None, entry.channel):
            yield entry
        else:
            count.left_out["frame of another channel"] += 1


def frames_of(source: Path) -> Iterator[Frame]:
    """Every frame of a log, of whatever bus.

    Raises:
        InputError: unreadable or unknown log.
    """
    return (entry.frame for entry in _entries(source) if isinstance(entry, LoggedFrame))


def _entries(source: Path) -> Iterator[LoggedFrame | LeftOut]:
    """Entries of a log of any kind, with times that can be recorded."""
    suffix = source.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"{source}: unknown kind of log; known are {', '.join(SUFFIXES)} (candump, Vector ASC, BLF)")
    check_ends(source, "log")
    try:
        for number, entry in enumerate(read_candump(source) if suffix == CANDUMP else _read_other(source), start=1):
            if isinstance(entry, LoggedFrame) and not 0 <= entry.frame.stamp_ns < LATEST_NS:
                raise InputError(f"{source}: entry {number}: a time before 1970 or after 2038: not a {suffix} log")
            yield entry
    except OSError as error:
        raise InputError(f"{source}: cannot read: {error.strerror}") from None


def _read_other(source: Path) -> Iterator[LoggedFrame | LeftOut]:
    """Through python-can's readers, which raise whatever a damaged file makes of them."""
    import can

    number, reader = 0, None
    try:
        with can.LogReader(source, relative_timestamp=False) as reader:
            for message in reader:
                yield _entry(message)
                number += 1
    except OSError:
        raise
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{source}: damaged after {number} entries, or not a {source.suffix} log: {reason}") from None
    if getattr(reader, "file_size", 0) > source.stat().st_size:  # which the header of a BLF gives
        yield CUT_OFF


def _entry(message: Any) -> LoggedFrame | LeftOut:
    if message.is_remote_frame or message.is_fd:
        return REMOTE_REQUEST if message.is_remote_frame else LONGER_FRAME
    if len(message.data) > DLC_MAX:
        raise ValueError(f"a frame of {len(message.data)} bytes")
    stamp_ns = round(message.timestamp * 1e6) * 1000  # a float of today's Unix time says no more than that
    number = message.arbitration_id | (EXTENDED_ID if message.is_extended_id and not message.is_error_frame else 0)
    channel = f"can{message.channel}" if isinstance(message.channel, int) else message.channel or ""
    return LoggedFrame(channel, Frame(number, bytes(message.data), stamp_ns, message.is_error_frame))
