"""Stamps of a log as its clock gave them, made to increase: what was wrong with them is said, never hidden.

Three things happen to clocks of loggers. Times are written as differences to the line before (`candump -t d`). A few
frames carry another time than those around them. The clock is set back while it logs, and from there on everything
would come before what is already there.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import chain, pairwise

from hil_gateway.process.clock import NS_PER_S
from hil_gateway.session.logs.entry import LOGGED_TWICE, Entry, LoggedFrame

LOOKED_AT = 256
"""first frames that tell differences from times"""
FALLING_SHARE = 0.2
"""of the steps from stamp to stamp: differences go up and down all the time, times hardly ever down"""
LONGEST_DIFFERENCE_NS = 3600 * NS_PER_S
SLIP_NS = NS_PER_S // 10
"""by which stamps of two buses, or of a driver and a recorder, may come out of order"""
FAR_NS = NS_PER_S
"""a step that is no more is taken as it is"""
HOPS_MAX = 10
"""frames in a row that can carry a wrong time; more of them are the time"""


class LogClock:
    """Repairs the stamps of one log in the order of the file; `notes` is final when `repaired` is exhausted."""

    def __init__(self) -> None:
        self.notes: list[str] = []
        self._hops, self._furthest_ns = 0, 0
        self._set_back: list[int] = []
        self._offset_ns = 0
        self._last_ns: int | None = None
        self._held: list[LoggedFrame] = []

    def repaired(self, entries: Iterable[Entry]) -> Iterator[Entry]:
        """The same entries with stamps that increase but for `SLIP_NS`; what was logged twice is left out."""
        yield from _once(self._in_order(self._as_times(iter(entries))))
        if self._hops:
            far = f"up to {self._furthest_ns / NS_PER_S:.3g} s off those around them"
            self.notes.append(f"{self._hops} frames are stamped {far}: taken at the time of the frame before")
        if self._set_back:
            back = max(self._set_back) / NS_PER_S
            times = f"{len(self._set_back)} times" if len(self._set_back) > 1 else "once"
            self.notes.append(
                f"the clock was set back {times}, by up to {back:.6g} s: what follows is put behind what was logged"
            )

    def _as_times(self, entries: Iterator[Entry]) -> Iterator[Entry]:
        head: list[Entry] = []
        stamps: list[int] = []
        for entry in entries:
            head.append(entry)
            if isinstance(entry, LoggedFrame):
                stamps.append(entry.frame.stamp_ns)
            if len(stamps) == LOOKED_AT:
                break
        if not are_differences(stamps):
            yield from chain(head, entries)
            return
        self.notes.append("times are differences to the frame before, as `candump -t d` prints them: added up")
        now_ns = 0
        for entry in chain(head, entries):
            if isinstance(entry, LoggedFrame):
                now_ns += entry.frame.stamp_ns
                yield _at(entry, now_ns)
            else:
                yield entry

    def _in_order(self, entries: Iterator[Entry]) -> Iterator[Entry]:
        for entry in entries:
            if not isinstance(entry, LoggedFrame):
                yield entry
                continue
            yield from self._next(_at(entry, entry.frame.stamp_ns + self._offset_ns) if self._offset_ns else entry)
        if self._held and self._held[0].frame.stamp_ns < (self._last_ns or 0):
            yield from self._hopped()
        yield from self._held

    def _next(self, entry: LoggedFrame) -> Iterator[LoggedFrame]:
        stamp_ns, last_ns = entry.frame.stamp_ns, self._last_ns
        if last_ns is None or (not self._held and -SLIP_NS <= stamp_ns - last_ns <= FAR_NS):
            self._last_ns = max(stamp_ns, last_ns or stamp_ns)
            yield entry
            return
        if self._held and self._is_back(stamp_ns, last_ns):
            yield from self._hopped()
            yield from self._next(entry)
            return
        if self._held and not -SLIP_NS <= stamp_ns - self._held[-1].frame.stamp_ns <= FAR_NS:
            yield from self._accepted()
            yield from self._next(_at(entry, stamp_ns + self._shifted_ns))
            return
        self._held.append(entry)
        if len(self._held) >= HOPS_MAX:
            yield from self._accepted()

    _shifted_ns = 0
    """by which the frames accepted last were moved"""

    def _is_back(self, stamp_ns: int, last_ns: int) -> bool:
        """Whether a frame goes on where the held ones left off."""
        ahead = self._held[0].frame.stamp_ns > last_ns
        until = self._held[0].frame.stamp_ns - SLIP_NS if ahead else last_ns + FAR_NS
        return last_ns - SLIP_NS <= stamp_ns < until

    def _hopped(self) -> Iterator[LoggedFrame]:
        """The held frames at the time of the one before them."""
        last_ns = self._last_ns or 0
        for entry in self._held:
            self._hops += 1
            self._furthest_ns = max(self._furthest_ns, abs(entry.frame.stamp_ns - last_ns))
            yield _at(entry, last_ns)
        self._held = []

    def _accepted(self) -> Iterator[LoggedFrame]:
        """The held frames as what the clock says now."""
        held, self._held, last_ns = self._held, [], self._last_ns or 0
        back_ns = last_ns - held[0].frame.stamp_ns
        self._shifted_ns = max(back_ns, 0)
        if back_ns > 0:
            self._set_back.append(back_ns)
            self._offset_ns += back_ns
        moved = [_at(entry, entry.frame.stamp_ns + self._shifted_ns) for entry in held]
        self._last_ns = max(entry.frame.stamp_ns for entry in moved)
        yield from moved


def are_differences(stamps: list[int]) -> bool:
    """Whether stamps in the order of a file are times since the one before."""
    if len(stamps) < 8 or max(map(abs, stamps)) > LONGEST_DIFFERENCE_NS:
        return False
    falling = sum(b < a for a, b in pairwise(stamps))
    return falling > FALLING_SHARE * len(stamps)


def _at(entry: LoggedFrame, stamp_ns: int) -> LoggedFrame:
    return LoggedFrame(entry.channel, replace(entry.frame, stamp_ns=stamp_ns))


def _once(entries: Iterator[Entry]) -> Iterator[Entry]:
    """Without frames that have the content and the time of the one before: a bus carries one at a time."""
    last: dict[tuple[str, int], tuple[int, bytes]] = {}
    for entry in entries:
        if isinstance(entry, LoggedFrame) and not entry.frame.is_error:
            frame = entry.frame
            if last.get((entry.channel, frame.id)) == (frame.stamp_ns, frame.data):
                yield LOGGED_TWICE
                continue
            last[entry.channel, frame.id] = (frame.stamp_ns, frame.data)
        yield entry
