"""What a CAN log holds: frames with the bus they were on, and what a recording has no place for."""

from __future__ import annotations

import re
import socket
from dataclasses import dataclass

from can_dbc.database import DLC_MAX
from hil_gateway.can_link import EXTENDED_ID, Frame
from hil_gateway.process.clock import NS_PER_S

EXTENDED_ID_MAX, STANDARD_ID_MAX = socket.CAN_EFF_MASK, socket.CAN_SFF_MASK
_SECONDS = re.compile(r"(-?)(\d{1,12})(?:[.,](\d*))?")


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
NAMELESS = LeftOut("message of a name the DBC does not have")
LOGGED_TWICE = LeftOut("frame that was logged twice")
Entry = LoggedFrame | LeftOut


def data_frame(channel: str, number: int, data: bytes, stamp_ns: int, *, extended: bool) -> LoggedFrame:
    """A classic data frame.

    Raises:
        ValueError: an identifier or a length that no such frame has.
    """
    if not 0 <= number <= (EXTENDED_ID_MAX if extended else STANDARD_ID_MAX):
        raise ValueError(f"{number:X} is no CAN identifier")
    if len(data) > DLC_MAX:
        raise ValueError(f"a frame of {len(data)} bytes")
    return LoggedFrame(channel, Frame(number | EXTENDED_ID if extended else number, data, stamp_ns))


def error_frame(channel: str, stamp_ns: int, classes: int = 0, data: bytes = b"") -> LoggedFrame:
    """An error frame; `classes` are the bits of SocketCAN's `can/error.h` where the log has them."""
    return LoggedFrame(channel, Frame(classes, data, stamp_ns, is_error=True))


def nanoseconds(text: str, unit_ns: int = NS_PER_S) -> int:
    """A time as a log writes it, `unit_ns` long for each whole number, without the rounding of a float.

    Raises:
        ValueError: no such number.
    """
    found = _SECONDS.fullmatch(text.strip())
    if found is None:
        raise ValueError(f"{text[:40]!r} is no time")
    sign, whole, fraction = found.groups()
    part = int(fraction[:18].ljust(18, "0")) * unit_ns // 10**18 if fraction else 0
    value = int(whole) * unit_ns + part
    return -value if sign else value
