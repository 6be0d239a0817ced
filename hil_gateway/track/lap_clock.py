"""Lap and sector times and the delta to the best lap, from positions along the track. Pure: time is an argument."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, field
from enum import StrEnum
from itertools import pairwise
from typing import Any

SECTORS = 3
"""of equal length: the tracks name none of their own"""
NEAR_LINE_M = 50.0
"""a car that drives off this close behind the line drives its first lap from there, any other an out lap"""
SLOWEST = 0.5
"""m/s; a car that is slower has not started"""
STATION_M = 5.0
"""spacing of the times kept of a lap"""
GAP_S = 1.0
"""between two positions: a car that brakes at 20 m/s2 from 60 m/s crosses the line 0.04 s off what is interpolated"""


class Mark(StrEnum):
    """Why a lap is not compared with others."""

    FROM_REST = "from rest"
    """it began where the car stood, up to `NEAR_LINE_M` beyond the line"""
    STOP = "stop"
    YELLOW = "yellow"
    GAP = "gap"
    """for longer than `GAP_S` it is not known where the car was"""


@dataclass(frozen=True)
class Lap:
    """One lap that was driven to its end; `stood_s` of it without moving."""

    number: int
    start_s: float
    time_s: float
    sectors_s: tuple[float, ...]
    marks: tuple[Mark, ...] = ()
    stood_s: float = 0.0

    @property
    def from_rest(self) -> bool:
        """Whether it did not begin at the line."""
        return Mark.FROM_REST in self.marks

    def tree(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "time_s": round(self.time_s, 3), "sectors_s": [round(s, 3) for s in self.sectors_s],
            "from_rest": self.from_rest, "marks": list(self.marks), "stood_s": round(self.stood_s, 1),
        }  # fmt: skip


@dataclass
class LapClock:
    """`update` with every position, in order; `laps` holds those that are complete, `best` the quickest without a mark.

    Crossings are interpolated between two positions, so a lap time is as good as these (at 10 Hz and 60 m/s some
    hundredths of a second). A jump by more than a tenth of the lap, or a gap in which the car may have gone round more
    than once, ends the lap without a time.
    """

    length: float
    laps: list[Lap] = field(default_factory=list)
    best: Lap | None = None
    _last: tuple[float, float, float] | None = None
    """time, arc length, speed"""
    _beyond: float = 0.0
    _start_s: float | None = None
    _marks: set[Mark] = field(default_factory=set)
    _stood_s: float = 0.0
    _stations: list[float] = field(default_factory=list)
    _times: list[float] = field(default_factory=list)
    _best_line: tuple[list[float], list[float]] = field(default_factory=lambda: ([], []))
    _splits: list[float] = field(default_factory=list)

    def update(self, t_s: float, s: float, speed: float, yellow: bool = False) -> Lap | None:
        """Take in a position at arc length `s` in [0, length); the lap it ended, if it ended one."""
        last, self._last = self._last, (t_s, s, speed)
        moved = None if last is None else self._moved(last, self._last)
        if last is None or moved is None:
            self._start_s, self._beyond = None, s - self.length
            return None
        if self._start_s is None and last[1] < NEAR_LINE_M and speed > SLOWEST and not self.laps:
            self._begin(_passed(last, self._last), {Mark.FROM_REST})
            self._beyond = last[1]
        if speed <= SLOWEST and (self._start_s is None or self._only_moved_up()):
            # a position that wavers across the line is no crossing
            self._start_s, self._beyond = None, s if s < NEAR_LINE_M else s - self.length
            return None
        known = len(self.laps)
        here = self._marks_of(last, self._last, yellow)
        self._marks |= here
        self._stood_s += t_s - last[0] if Mark.STOP in here else 0.0
        self._advance(last[0], t_s, moved, here)
        if self._start_s is not None and (not self._stations or self._beyond - self._stations[-1] >= STATION_M):
            self._stations.append(self._beyond)
            self._times.append(t_s - self._start_s)
        return self.laps[-1] if len(self.laps) > known else None

    def _only_moved_up(self) -> bool:
        """Whether the car has gone a little way from rest, as it is pushed to the line."""
        return Mark.FROM_REST in self._marks and self._beyond < NEAR_LINE_M

    def _moved(self, last: tuple[float, float, float], now: tuple[float, float, float]) -> float | None:
        """Metres from one position to the next, None where that cannot be said; after a gap by time and speeds."""
        elapsed_s, ahead = now[0] - last[0], now[1] - last[1]
        expected = 0.5 * (last[2] + now[2]) * elapsed_s if elapsed_s > GAP_S else 0.0
        moved = ahead + self.length * round((expected - ahead) / self.length)
        sure = expected <= self.length if elapsed_s > GAP_S else abs(moved) <= 0.1 * self.length
        return moved if sure else None

    @staticmethod
    def _marks_of(last: tuple[float, float, float], now: tuple[float, float, float], yellow: bool) -> set[Mark]:
        found = {Mark.GAP: now[0] - last[0] > GAP_S, Mark.STOP: now[2] <= SLOWEST, Mark.YELLOW: yellow}
        return {mark for mark, there in found.items() if there}

    def current_s(self, t_s: float) -> float | None:
        """Time since the line; None before the first lap."""
        return None if self._start_s is None else t_s - self._start_s

    def delta_s(self, t_s: float, s: float) -> float | None:
        """How much later the car is here than in its best lap, s; None without one."""
        stations, times = self._best_line
        if self._start_s is None or len(stations) < 2:
            return None
        i = min(max(bisect_left(stations, s), 1), len(stations) - 1)
        weight = (s - stations[i - 1]) / (stations[i] - stations[i - 1])
        return t_s - self._start_s - (times[i - 1] + weight * (times[i] - times[i - 1]))

    def _begin(self, t_s: float, marks: set[Mark]) -> None:
        self._start_s, self._marks, self._stood_s = t_s, marks, 0.0
        self._stations, self._times, self._splits = [], [], []

    def _advance(self, last_s: float, t_s: float, moved: float, marks: set[Mark]) -> None:
        """Go on by `moved` metres with what marks them; note the line and the sector boundaries that lie in between."""
        before, self._beyond = self._beyond, self._beyond + moved
        while moved > 0 and self._beyond >= (boundary := self._next_boundary()):
            at_s = last_s + (boundary - before) / moved * (t_s - last_s)
            if self._start_s is None:
                self._begin(at_s, set(marks))
                continue
            self._splits.append(at_s - self._start_s)
            if len(self._splits) == SECTORS:
                before, self._beyond = before - self.length, self._beyond - self.length
                self._finish(self._start_s)
                self._begin(at_s, set(marks))

    def _next_boundary(self) -> float:
        return 0.0 if self._start_s is None else (len(self._splits) + 1) * self.length / SECTORS

    def _finish(self, start_s: float) -> None:
        """The lap that ends here."""
        sectors = tuple(b - a for a, b in pairwise([0.0, *self._splits]))
        marks = tuple(mark for mark in Mark if mark in self._marks)
        lap = Lap(len(self.laps) + 1, start_s, self._splits[-1], sectors, marks, self._stood_s)
        self.laps.append(lap)
        if not marks and (self.best is None or lap.time_s < self.best.time_s):
            self.best, self._best_line = lap, (self._stations, self._times)


def _passed(last: tuple[float, float, float], now: tuple[float, float, float]) -> float:
    """When a car that has not started before `now` was at `SLOWEST`, s."""
    share = (SLOWEST - last[2]) / (now[2] - last[2]) if now[2] > last[2] else 0.0
    return last[0] + max(share, 0.0) * (now[0] - last[0])
