"""Any CAN log as one stream of frames: the format is told by what the file holds, whatever its name."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from hil_gateway.process.clock import NS_PER_S
from hil_gateway.process.errors import InputError
from hil_gateway.session.logs import asc, bag, candump, python_can, table, trc
from hil_gateway.session.logs.clock import LogClock
from hil_gateway.session.logs.entry import CUT_OFF, Entry, LeftOut, LoggedFrame
from hil_gateway.session.logs.raw_bag import is_mcap, is_sqlite
from hil_gateway.session.logs.source import DAMAGED, Source

LATEST_NS = (1 << 31) * NS_PER_S
"""what the recorded form of a frame can say: 2038"""
Names = Mapping[str, int]
"""message -> identifier, for logs that name messages"""


@dataclass(frozen=True)
class Format:
    """One kind of log."""

    name: str
    recognises: Callable[[Source], bool]
    read: Callable[[Source, Names], Iterator[Entry]]


def _plain(read: Callable[[Source], Iterator[Entry]]) -> Callable[[Source, Names], Iterator[Entry]]:
    return lambda source, names: read(source)


FORMATS = (
    Format("MCAP", is_mcap, _plain(bag.read_bag)),
    Format("rosbag2 SQLite", is_sqlite, _plain(bag.read_bag)),
    Format("BLF", python_can.is_blf, _plain(python_can.read_blf)),
    Format("MDF", python_can.is_mdf, _plain(python_can.read_mdf)),
    Format("TRC", trc.recognises, _plain(trc.read_trc)),
    Format("ASC", asc.recognises, asc.read_asc),
    Format("table of frames", table.recognises, _plain(table.read_table)),
    Format("candump", candump.recognises, _plain(candump.read_candump)),
)
"""in the order they are asked; a further format is one module and one line here"""


@dataclass
class Log:
    """One CAN log. `notes` and `left_out` are final when `frames` is exhausted."""

    path: Path
    format: str
    _entries: Iterator[Entry]
    notes: list[str] = field(default_factory=list)
    """what is to be known of the log, in plain words"""
    left_out: Counter[str] = field(default_factory=Counter)
    """entries a recording has no place for, by kind"""

    def frames(self) -> Iterator[LoggedFrame]:
        """Every classic data and error frame, of whatever bus, at times that increase.

        Raises:
            InputError: a place that cannot be read.
        """
        for entry in self._entries:
            if isinstance(entry, LeftOut):
                self.left_out[entry.kind] += 1
            else:
                yield entry


def open_log(path: Path, names: Names | None = None) -> Log:
    """The frames of a log of any kind; `names` for logs that name messages instead of numbering them.

    Raises:
        InputError: unreadable, or of no known kind.
    """
    if path.is_dir():
        source, found = Source(path), FORMATS[0]
    else:
        source = Source(path)
        found = _format_of(source) or _refuse(source)
    log = Log(path, found.name, iter(()))
    log._entries = _checked(log, source, found.read(source, names or {}))
    return log


def _format_of(source: Source) -> Format | None:
    return next((one for one in FORMATS if one.recognises(source)), None)


def _refuse(source: Source) -> Format:
    if not source.head:
        raise InputError(f"{source.path}: holds no CAN frames: the file is empty")
    known, drive_logs = ", ".join(one.name for one in FORMATS), "drive logs go to `hil identify` and `hil diagnose`"
    raise InputError(f"{source.path}: unknown kind of log; known are {known}; {drive_logs}")


def _checked(log: Log, source: Source, entries: Iterator[Entry]) -> Iterator[Entry]:
    """Entries at repaired times that can be recorded; then the notes are complete."""
    clock = LogClock()
    try:
        for number, entry in enumerate(clock.repaired(entries), start=1):
            if isinstance(entry, LoggedFrame) and not 0 <= entry.frame.stamp_ns < LATEST_NS:
                beyond = "a time before 1970 or after 2038"
                raise InputError(f"{log.path}: entry {number}: {beyond}: not a {log.format} log")
            yield entry
    except DAMAGED:
        source.cut = True
    if source.cut:
        yield CUT_OFF
    log.notes += [*source.notes, *clock.notes]
