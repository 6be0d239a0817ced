"""TRC logs of PEAK-System's programs, versions 1.0 to 2.1.

Read here and not through python-can: its reader takes version 1.2 for 1.0, says nothing of the error frames it drops,
and rounds times.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

from hil_gateway.process.errors import InputError
from hil_gateway.session.logs.entry import (
    CUT_OFF,
    LONGER_FRAME,
    REMOTE_REQUEST,
    Entry,
    data_frame,
    error_frame,
    nanoseconds,
)
from hil_gateway.session.logs.source import Source
from hil_gateway.session.logs.wall_clock import from_days, parse_date

_SETTING = re.compile(r";\$(\w+)\s*=\s*(\S.*?)\s*")
_STARTED = re.compile(r";\s*Start time:\s*(.+)", re.IGNORECASE)
NS_PER_MS = 1_000_000
COLUMNS = {"1.0": "NOIlD", "1.1": "NOTIlD", "1.2": "NOBTIlD", "1.3": "NOBTIRlD"}
"""version -> columns of a line: number, offset, type or direction, bus, identifier, length, reserved, data"""
FRAMES = {"DT", "RX", "TX", ""}
LONGER = {"FD", "FB", "FE", "BI"}
ERRORS = {"ER", "ERROR"}


def recognises(source: Source) -> bool:
    """Whether the file begins with the header of such a log."""
    head = source.first_lines[:30]
    return any(line.startswith((";$FILEVERSION", ";$STARTTIME")) for line in head) or (
        any(_STARTED.match(line) for line in head) and any(re.match(r"\s*1\)\s", line) for line in source.first_lines)
    )


def read_trc(source: Source) -> Iterator[Entry]:
    """Entries of a log.

    Raises:
        InputError: a line that is none of such a log, with its number.
    """
    log = _TrcLog()
    for line in source.lines():
        if not line.text.strip() or line.text.startswith(";"):
            log.setting(line.text)
            continue
        try:
            entry = log.entry(line.text)
        except (ValueError, IndexError) as error:
            if not line.ended:
                yield CUT_OFF
                return
            raise InputError(f"{source.path}: line {line.number}: {error}: not a TRC log") from None
        if entry is not None:
            yield entry


@dataclass
class _TrcLog:
    """What the header says."""

    columns: str = COLUMNS["1.0"]
    start_ns: int = 0
    dated: bool = False

    def setting(self, line: str) -> None:
        """Note a line of the header."""
        if found := _SETTING.fullmatch(line):
            name, value = found[1].upper(), found[2]
            if name == "FILEVERSION":
                self.columns = COLUMNS.get(value, self.columns)
            elif name == "STARTTIME":
                self.start_ns, self.dated = from_days(float(value.replace(",", "."))), True
            elif name == "COLUMNS":
                self.columns = value.replace(",", "")
        elif (found := _STARTED.match(line)) and not self.dated:
            self.start_ns = parse_date(found[1]) or 0

    def entry(self, line: str) -> Entry | None:
        """What a line adds, if anything."""
        cells = dict(zip(self.columns, line.split(maxsplit=len(self.columns) - 1), strict=False))
        stamp_ns = self.start_ns + nanoseconds(cells["O"], NS_PER_MS) if "O" in cells else 0
        channel, kind = f"can{int(cells.get('B', '1')) - 1}", cells.get("T", "").upper()
        if kind in ERRORS:
            return error_frame(channel, stamp_ns)
        if kind in LONGER:
            return LONGER_FRAME
        content = cells.get("D", "")
        if kind == "RR" or content.upper().startswith("RTR"):
            return REMOTE_REQUEST
        if kind not in FRAMES or cells.get("I", "").upper() == "FFFFFFFF":  # status of the bus, counters, events
            return None
        number, length = cells["I"], int(cells.get("l") or cells["L"])
        data = bytes.fromhex("".join(content.split()[:length]))
        if len(data) < length:
            raise ValueError(f"{len(data)} bytes of a frame of {length}")
        return data_frame(channel, int(number, 16), data, stamp_ns, extended=len(number) > 4)
