"""ASC logs: Vector's, and what BUSMASTER and others write under that name.

Read here and not through python-can: its reader knows dates in two languages, loses the first frame behind a header
of BUSMASTER's, takes times since midnight and times since the line before for times since the start, and drops frames
that are logged by name.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from can_dbc.database import DLC_MAX
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.process.errors import InputError
from hil_gateway.session.logs.entry import (
    CUT_OFF,
    LONGER_FRAME,
    NAMELESS,
    REMOTE_REQUEST,
    Entry,
    LeftOut,
    data_frame,
    error_frame,
    nanoseconds,
)
from hil_gateway.session.logs.source import Line, Source
from hil_gateway.session.logs.wall_clock import of_day_ns, parse_date

_DATE = re.compile(r"\s*date\s+(.+)", re.IGNORECASE)
_BASE = re.compile(r"\s*base\s+(hex|dec)\b(?:\s+timestamps\s+(absolute|relative))?", re.IGNORECASE)
_TRIGGER = re.compile(r"\s*begin\s+trigger\s?block\s+(.+)", re.IGNORECASE)
_MILLISECONDS = re.compile(r"(?<=:\d\d\.)\d{1,2}(?!\d)")
"""python-can writes those of a date without leading zeros"""
_EVENT = re.compile(r"\s*(-?\d+[.,]\d+)\s+(\S+)\s+(.*)")
_CLASSIC = re.compile(r"(\S+)\s+(Rx|Tx|TxRq)\s+([dr])\b\s*(?:([0-9A-F]{1,2})\b)?\s*(.*)", re.IGNORECASE)
_LONGER = re.compile(r"(\d+)\s+(Rx|Tx|TxRq)\s+(\S+)\s+(.*)", re.IGNORECASE)
REQUEST_TO_SEND = "txrq"
"""not on the bus yet: the frame itself follows"""
MIDNIGHT_WITHIN_NS = 3600 * NS_PER_S
"""A first time that is that of the day in the header, at most so much later, counts from midnight."""
EDL = 1 << 12
"""flag of a frame that is longer than a classic one (Extended Data Length)"""


def recognises(source: Source) -> bool:
    """Whether a header of an ASC log is among the first lines."""
    head = source.first_lines[:50]
    dated = any(_DATE.match(line) or _TRIGGER.match(line) for line in head)
    return any(_BASE.match(line) for line in head) or (dated and any(_EVENT.match(line) for line in head))


def read_asc(source: Source, names: Mapping[str, int]) -> Iterator[Entry]:
    """Entries of a log; `names` are the identifiers of messages that are logged by name.

    Raises:
        InputError: a frame that is none, with its line.
    """
    log = _AscLog(names)
    for line in source.lines():
        try:
            entry = log.entry(line)
        except ValueError as error:
            if not line.ended:
                yield CUT_OFF
                return
            raise InputError(f"{source.path}: line {line.number}: {error}: not an ASC log") from None
        if entry is not None:
            yield entry


def _padded(date: str) -> str:
    """A date whose milliseconds have three digits, as the format has them."""
    return _MILLISECONDS.sub(lambda found: found[0].rjust(3, "0"), date)


@dataclass
class _AscLog:
    """What the header and the lines so far say."""

    names: Mapping[str, int]
    base: int = 16
    relative: bool = False
    start_ns: int = 0
    elapsed_ns: int = 0
    midnight: bool | None = None
    since_midnight: bool = field(default=True)
    """whether the header leaves open from when times count"""

    def entry(self, line: Line) -> Entry | None:
        """What a line adds, if anything."""
        if found := _EVENT.match(line.text):
            return self._event(*found.groups())
        if found := _BASE.match(line.text):
            self.base = 10 if found[1].lower() == "dec" else 16
            self.relative, self.since_midnight = (found[2] or "").lower() == "relative", found[2] is None
        elif found := _DATE.match(line.text) or _TRIGGER.match(line.text):
            self.start_ns = parse_date(_padded(found[1])) or self.start_ns
        return None

    def _event(self, time: str, where: str, rest: str) -> Entry | None:
        stamp_ns = self._stamp(nanoseconds(time))
        if where.upper() == "CANFD":
            return self._longer(stamp_ns, rest)
        if not where.isdigit():  # status of a controller, statistics, J1939
            return None
        channel = f"can{int(where) - 1}"
        if rest.lower().startswith("errorframe"):
            return error_frame(channel, stamp_ns)
        found = _CLASSIC.match(rest)
        if found is None or found[2].lower() == REQUEST_TO_SEND:
            return None
        number, _, kind, length, content = found.groups()
        if kind.lower() == "r":
            return REMOTE_REQUEST
        return self._frame(channel, number, min(int(length or "0", 16), DLC_MAX), content, stamp_ns)

    def _stamp(self, time_ns: int) -> int:
        """Unix ns; the first time of a log of a day's clock says whether it counts from midnight."""
        if self.midnight is None:
            late = time_ns - of_day_ns(self.start_ns)
            self.midnight = self.since_midnight and -NS_PER_S <= late <= MIDNIGHT_WITHIN_NS and time_ns > NS_PER_S
            self.start_ns -= of_day_ns(self.start_ns) if self.midnight else 0
        self.elapsed_ns = self.elapsed_ns + time_ns if self.relative else time_ns
        return self.start_ns + self.elapsed_ns

    def _frame(self, channel: str, number: str, length: int, content: str, stamp_ns: int) -> Entry:
        found = self._identifier(number)
        if isinstance(found, LeftOut):
            return found
        value, extended = found
        data = bytes(int(byte, self.base) for byte in content.split()[:length])
        if len(data) < length:
            raise ValueError(f"{len(data)} bytes of a frame of {length}")
        return data_frame(channel, value, data, stamp_ns, extended=extended)

    def _identifier(self, text: str) -> tuple[int, bool] | LeftOut:
        """Value and whether it has 29 bits."""
        extended = text[-1:].lower() == "x"
        try:
            return int(text[:-1] if extended else text, self.base), extended
        except ValueError:
            number = self.names.get(text)
            return NAMELESS if number is None else (number & 0x1FFFFFFF, number > 0x1FFFFFFF)

    def _longer(self, stamp_ns: int, rest: str) -> Entry | None:
        """`channel Rx id [name] brs esi dlc length data duration bits flags ...`: also of classic frames."""
        found = _LONGER.match(rest)
        if found is None or found[2].lower() == REQUEST_TO_SEND:
            return None
        channel, number, words = f"can{int(found[1]) - 1}", found[3], found[4].split()
        if number.lower() == "errorframe":
            return error_frame(channel, stamp_ns)
        if words and words[0] not in ("0", "1"):
            words = words[1:]  # the name
        length = int(words[3])
        data, after = words[4 : 4 + length], words[4 + length :]
        if length > DLC_MAX or len(after) < 3 or int(after[2], 16) & EDL:
            return LONGER_FRAME
        return self._frame(channel, number, length, " ".join(data), stamp_ns)
