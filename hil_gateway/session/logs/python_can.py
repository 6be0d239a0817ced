"""Logs that python-can reads right: BLF, and MDF 4 where asammdf is installed."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterator
from typing import Any

from hil_gateway.can_link import EXTENDED_ID
from hil_gateway.process.errors import InputError
from hil_gateway.session.logs.entry import (
    CUT_OFF,
    LONGER_FRAME,
    REMOTE_REQUEST,
    Entry,
    data_frame,
    error_frame,
)
from hil_gateway.session.logs.source import Source


def is_blf(source: Source) -> bool:
    """By the first bytes."""
    return source.head.startswith(b"LOGG")


def is_mdf(source: Source) -> bool:
    """By the first bytes."""
    return source.head.startswith((b"MDF     ", b"UnFinMF "))


def read_blf(source: Source) -> Iterator[Entry]:
    """Entries of a BLF log.

    Raises:
        InputError: a file that python-can's reader does not take.
    """
    import can

    return _read(source, lambda: can.BLFReader(source.path))


def read_mdf(source: Source) -> Iterator[Entry]:
    """Entries of the raw frames of an MDF 4 file.

    Raises:
        InputError: asammdf is missing, or a file that its reader does not take.
    """
    if importlib.util.find_spec("asammdf") is None:
        raise InputError(f"{source.path}: MDF needs the package asammdf; install hil-gateway[mdf]")
    import can

    return _read(source, lambda: can.MF4Reader(source.path))


def _read(source: Source, make: Callable[[], Any]) -> Iterator[Entry]:
    """Whatever its readers raise for a damaged file is one line."""
    number, reader = 0, None
    if source.packed:
        raise InputError(f"{source.path}: unpack it first: this kind of log is read in place")
    try:
        with make() as reader:
            for message in reader:
                yield _entry(message)
                number += 1
    except OSError as error:
        raise InputError(f"{source.path}: cannot read: {error.strerror or error}") from None
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{source.path}: damaged after {number} entries: {reason}") from None
    if getattr(reader, "file_size", 0) > source.path.stat().st_size:  # which the header of a BLF gives
        yield CUT_OFF


def _entry(message: Any) -> Entry:
    if message.is_remote_frame or message.is_fd:
        return REMOTE_REQUEST if message.is_remote_frame else LONGER_FRAME
    stamp_ns = round(message.timestamp * 1e6) * 1000  # a float of today's Unix time says no more than that
    channel = f"can{message.channel}" if isinstance(message.channel, int) else message.channel or ""
    if message.is_error_frame:
        return error_frame(channel, stamp_ns, message.arbitration_id & ~EXTENDED_ID, bytes(message.data))
    return data_frame(channel, message.arbitration_id, bytes(message.data), stamp_ns, extended=message.is_extended_id)
