"""The log format of can-utils (`candump -l`, read by canplayer): one line a frame, times to the microsecond.

Read here and not through python-can: its reader takes times as floating-point numbers, which moves half of them by a
microsecond, and makes extended data frames of most error frames.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from hil_gateway.can_link import EXTENDED_ID, Frame
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.process.errors import InputError

ERROR_FLAG = 0x20000000
EXTENDED_ID_MAX = 0x1FFFFFFF
_LINE = re.compile(r"\((\d{1,10})\.(\d{1,9})\)\s+(\S+)\s+([0-9A-F]{3}|[0-9A-F]{8})#(.*?)(?:\s+[RT])?\s*", re.IGNORECASE)
_DATA = re.compile(r"((?:[0-9A-F]{2}\.?){0,8})(?:_[9A-F])?", re.IGNORECASE)
"""bytes with optional dots between; after eight of them perhaps the raw length code"""


@dataclass(frozen=True, slots=True)
class LoggedFrame:
    """One frame of a log, and the bus it was on."""

    channel: str
    frame: Frame


@dataclass(frozen=True, slots=True)
class LeftOut:
    """One entry of a log that a recording has no place for."""

    kind: str


REMOTE_REQUEST, LONGER_FRAME = LeftOut("remote request"), LeftOut("CAN FD or CAN XL frame")
CUT_OFF = LeftOut("end that was cut off")


def format_line(frame: Frame, channel: str) -> str:
    """A frame as `candump -l` writes it, without the line end."""
    seconds, rest = divmod(frame.stamp_ns, NS_PER_S)
    return f"({seconds}.{rest // 1000:06d}) {channel} {_number(frame)}#{frame.data.hex().upper()}"


def _number(frame: Frame) -> str:
    """Identifier as candump writes it: three digits, eight for extended and error frames."""
    if frame.is_error:
        return f"{frame.id | ERROR_FLAG:08X}"
    return f"{frame.id & ~EXTENDED_ID:08X}" if frame.id & EXTENDED_ID else f"{frame.id:03X}"


def parse_line(line: str) -> LoggedFrame | LeftOut:
    """Inverse of `format_line`.

    Raises:
        ValueError: not a line of such a log.
    """
    found = _LINE.fullmatch(line)
    if found is None:
        raise ValueError("not `(seconds) channel identifier#data`")
    seconds, fraction, channel, number, content = found.groups()
    if content[:1].upper() == "R":
        return REMOTE_REQUEST
    if "#" in content:
        return LONGER_FRAME
    data = _DATA.fullmatch(content)
    if data is None:
        raise ValueError(f"{content!r} is no data of a CAN frame")
    stamp_ns = int(seconds) * NS_PER_S + int(fraction.ljust(9, "0"))
    return LoggedFrame(channel, _frame(number, bytes.fromhex(data[1].replace(".", "")), stamp_ns))


def _frame(number: str, data: bytes, stamp_ns: int) -> Frame:
    value = int(number, 16)
    if len(number) == 8 and value & ERROR_FLAG:
        return Frame(value & ~ERROR_FLAG & EXTENDED_ID_MAX, data, stamp_ns, is_error=True)
    if value > (EXTENDED_ID_MAX if len(number) == 8 else 0x7FF):
        raise ValueError(f"{number} is no CAN identifier")
    return Frame(value | EXTENDED_ID if len(number) == 8 else value, data, stamp_ns)


def read_candump(path: Path) -> Iterator[LoggedFrame | LeftOut]:
    """Entries of a log. A last line that was cut off is left out.

    Raises:
        InputError: a line that is none of such a log, with its number.
        OSError: unreadable.
    """
    with path.open(encoding="ascii", errors="replace", newline="\n") as file:
        for number, line in enumerate(file, start=1):
            if not line.strip():
                continue
            try:
                yield parse_line(line)
            except ValueError as error:
                if not line.endswith("\n"):
                    yield CUT_OFF
                    return
                raise InputError(f"{path}: line {number}: {error}: not a candump log") from None
