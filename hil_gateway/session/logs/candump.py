"""The formats of can-utils: `candump -l` (read by canplayer) and what candump prints with `-t`.

Read here and not through python-can: its reader takes times as floating-point numbers, which moves half of them by a
microsecond, makes extended data frames of most error frames, and does not know what candump prints.
"""

from __future__ import annotations

import re
import socket
from collections.abc import Iterator
from datetime import UTC, datetime

from hil_gateway.can_link import EXTENDED_ID, Frame
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.process.errors import InputError
from hil_gateway.session.logs.entry import (
    CUT_OFF,
    EXTENDED_ID_MAX,
    LONGER_FRAME,
    REMOTE_REQUEST,
    Entry,
    data_frame,
    error_frame,
    nanoseconds,
)
from hil_gateway.session.logs.source import Source

_STAMP = r"\s*\(([^)]*)\)\s+"
_LINE = re.compile(_STAMP + r"(\S+)\s+([0-9A-F]{3}|[0-9A-F]{8})#(.*?)(?:\s+[RT])?\s*", re.IGNORECASE)
_DATA = re.compile(r"((?:[0-9A-F]{2}\.?){0,8})(?:_[9A-F])?", re.IGNORECASE)
"""bytes with optional dots between; after eight of them perhaps the raw length code"""
_PRINTED = re.compile(
    r"\s*(?:\(([^)]*)\)\s+)?(\S+)\s+(?:[RT]X\s+\S+\s+\S+\s+)?([0-9A-F]{3}|[0-9A-F]{8})"
    r"\s+\[(\d{1,2})\]\s*(.*)",
    re.IGNORECASE,
)
_BYTES = re.compile(r"((?:[0-9A-F]{2}(?:\s+|$))*)", re.IGNORECASE)
_DATE = re.compile(r"(\d{4})-(\d\d)-(\d\d) (\d\d):(\d\d):(\d\d)(\.\d+)?")


def format_line(frame: Frame, channel: str) -> str:
    """A frame as `candump -l` writes it, without the line end."""
    seconds, rest = divmod(frame.stamp_ns, NS_PER_S)
    return f"({seconds}.{rest // 1000:06d}) {channel} {_number(frame)}#{frame.data.hex().upper()}"


def _number(frame: Frame) -> str:
    """Identifier as candump writes it: three digits, eight for extended and error frames."""
    if frame.is_error:
        return f"{frame.id | socket.CAN_ERR_FLAG:08X}"
    return f"{frame.id & ~EXTENDED_ID:08X}" if frame.id & EXTENDED_ID else f"{frame.id:03X}"


def parse_line(line: str) -> Entry:
    """Inverse of `format_line`; a line that candump prints as well.

    Raises:
        ValueError: not a line of such a log.
    """
    found = _LINE.fullmatch(line)
    if found is None:
        return _printed(line)
    stamp, channel, number, content = found.groups()
    if content[:1].upper() == "R":
        return REMOTE_REQUEST
    if "#" in content:
        return LONGER_FRAME
    data = _DATA.fullmatch(content)
    if data is None:
        raise ValueError(f"{content!r} is no data of a CAN frame")
    return _frame(channel, number, bytes.fromhex(data[1].replace(".", "")), _time(stamp))


def _printed(line: str) -> Entry:
    """A line as candump prints it: `(time)  can0  123   [2]  11 22`."""
    found = _PRINTED.fullmatch(line)
    if found is None:
        raise ValueError("not `(seconds) channel identifier#data`")
    stamp, channel, number, length, content = found.groups()
    if stamp is None:
        raise ValueError("no time: candump prints it with -t a, and logs it with -l")
    if content.lower().startswith("remote"):
        return REMOTE_REQUEST
    if len(length) == 2:  # [08] where classic frames have [8]
        return LONGER_FRAME
    shown = _BYTES.match(content)
    data = bytes.fromhex(shown[1])[: int(length)] if shown else b""
    if len(data) < int(length):
        raise ValueError(f"{content!r} are not {length} bytes of a CAN frame")
    return _frame(channel, number, data, _time(stamp))


def _time(stamp: str) -> int:
    """ns of seconds, or of the date that `-t A` prints."""
    found = _DATE.fullmatch(stamp.strip())
    if found is None:
        return nanoseconds(stamp)
    *date, fraction = found.groups()
    whole = int(datetime(*map(int, date), tzinfo=UTC).timestamp())  # type: ignore[misc, arg-type]
    return whole * NS_PER_S + nanoseconds(f"0{fraction or '.0'}")


def _frame(channel: str, number: str, data: bytes, stamp_ns: int) -> Entry:
    value, extended = int(number, 16), len(number) == 8
    if extended and value & socket.CAN_ERR_FLAG:
        return error_frame(channel, stamp_ns, value & ~socket.CAN_ERR_FLAG & EXTENDED_ID_MAX, data)
    return data_frame(channel, value, data, stamp_ns, extended=extended)


def recognises(source: Source) -> bool:
    """Whether one of the first lines looks like one of candump."""
    return any(_LINE.fullmatch(line) or _PRINTED.fullmatch(line) for line in source.first_lines[:20])


def read_candump(source: Source) -> Iterator[Entry]:
    """Entries of a log. A last line that was cut off is left out.

    Raises:
        InputError: a line that is none of such a log, with its number.
    """
    for line in source.lines():
        if not line.text.strip():
            continue
        try:
            yield parse_line(line.text)
        except ValueError as error:
            if not line.ended:
                yield CUT_OFF
                return
            raise InputError(f"{source.path}: line {line.number}: {error}: not a candump log") from None
