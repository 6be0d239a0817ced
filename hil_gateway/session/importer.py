"""Raw frames of a candump, ASC or BLF log -> session, through python-can's readers."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Any

from hil_gateway.can_link import EXTENDED_ID, Frame
from hil_gateway.clock import NS_PER_S
from hil_gateway.errors import InputError
from hil_gateway.session.format import CAN_TOPIC, METADATA_SESSION, dbc_hash, pack_frame, software_version
from hil_gateway.session.recover import FLUSH_EVERY, open_output

SUFFIXES = (".log", ".asc", ".blf")
DLC_MAX = 8
LATEST_NS = (1 << 31) * NS_PER_S
"""what the recorded form of a frame can say: 2038"""


def import_log(source: Path, target: Path) -> int:
    """Write every classic CAN data frame of `source` to a new session; returns their number.

    Raises:
        InputError: unreadable, unknown or empty log.
    """
    provenance = {"name": source.stem, "imported_from": source.name}
    metadata = {METADATA_SESSION: {**provenance, "software": software_version(), "dbc_sha256": dbc_hash()}}
    frames = _frames(source)
    first = next(frames, None)
    if first is None:
        raise InputError(f"{source}: holds no CAN frames")
    count = 0
    with open_output(target, metadata) as file:
        for count, frame in enumerate(chain((first,), frames), start=1):
            file.add(CAN_TOPIC, pack_frame(frame, frame.stamp_ns), frame.stamp_ns, frame.stamp_ns, count)
            if count % FLUSH_EVERY == 0:
                file.flush()
    return count


def _frames(source: Path) -> Iterator[Frame]:
    import can

    if source.suffix.lower() not in SUFFIXES:
        raise InputError(f"{source}: unknown kind of log; known are {', '.join(SUFFIXES)} (candump, Vector ASC, BLF)")
    try:
        with can.LogReader(source) as reader:
            for message in reader:
                if not message.is_remote_frame and not message.is_fd:
                    yield _frame(message)
    except OSError as error:
        raise InputError(f"{source}: cannot read: {error.strerror}") from None
    except Exception as error:  # its readers raise whatever a damaged file makes of them
        raise InputError(f"{source}: not a {source.suffix} log: {error}") from None


def _frame(message: Any) -> Frame:
    stamp_ns = round(message.timestamp * NS_PER_S)
    if not 0 <= stamp_ns < LATEST_NS or len(message.data) > DLC_MAX:
        raise ValueError(f"a frame of {len(message.data)} bytes at {message.timestamp} s")
    number = message.arbitration_id | (EXTENDED_ID if message.is_extended_id else 0)
    return Frame(number, bytes(message.data), stamp_ns, message.is_error_frame)
