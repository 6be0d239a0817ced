"""Lap and sector times and the delta to the best lap, from positions along the track. Pure: time is an argument."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, field
from itertools import pairwise

SECTORS = 3
"""of equal length: the tracks name none of their own"""
NEAR_LINE_M = 50.0
"""a car that starts to move this close behind the line drives its first lap from there, any other an out lap"""
SLOWEST = 0.5
"""m/s; a car that is slower has not started"""
STATION_M = 5.0
"""spacing of the times kept of a lap"""


@dataclass(frozen=True)
class Lap:
    """One lap that was driven to its end."""

    number: int
    start_s: float
    time_s: float
    sectors_s: tuple[float, ...]
    from_rest: bool = False
    """it began where the car stood, up to `NEAR_LINE_M` beyond the line"""


@dataclass
class LapClock:
    """`update` with every position, in order; `laps` holds those that are complete.

    Crossings are interpolated between two positions, so a lap time is as good as these (at 10 Hz and 60 m/s some
    hundredths of a second). A jump by more than a tenth of the lap ends the lap without a time.
    """

    length: float
    laps: list[Lap] = field(default_factory=list)
    best: Lap | None = None
    _last: tuple[float, float] | None = None
    _beyond: float = 0.0
    _start_s: float | None = None
    _from_rest: bool = False
    _stations: list[float] = field(default_factory=list)
    _times: list[float] = field(default_factory=list)
    _best_line: tuple[list[float], list[float]] = field(default_factory=lambda: ([], []))
    _splits: list[float] = field(default_factory=list)

    def update(self, t_s: float, s: float, speed: float) -> Lap | None:
        """Take in a position at arc length `s` in [0, length); the lap it ended, if it ended one."""
        last, self._last = self._last, (t_s, s)
        moved = 0.0 if last is None else (s - last[1] + 0.5 * self.length) % self.length - 0.5 * self.length
        if last is None or abs(moved) > 0.1 * self.length:
            self._start_s, self._beyond = None, s - self.length
            return None
        if self._start_s is None and last[1] < NEAR_LINE_M and speed > SLOWEST and not self.laps:
            self._begin(last[0], from_rest=True)
            self._beyond = last[1]
        if self._start_s is None and speed <= SLOWEST:  # a position that wavers across the line is no crossing
            self._beyond = s if s < NEAR_LINE_M else s - self.length
            return None
        ended = self._advance(last[0], t_s, moved)
        if self._start_s is not None and (not self._stations or self._beyond - self._stations[-1] >= STATION_M):
            self._stations.append(self._beyond)
            self._times.append(t_s - self._start_s)
        return ended

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

    def _begin(self, t_s: float, from_rest: bool = False) -> None:
        self._start_s, self._from_rest = t_s, from_rest
        self._stations, self._times, self._splits = [], [], []

    def _advance(self, last_s: float, t_s: float, moved: float) -> Lap | None:
        """Go on by `moved` metres; note the line or the sector boundary that lies in between."""
        before, self._beyond = self._beyond, self._beyond + moved
        boundary = 0.0 if self._start_s is None else (len(self._splits) + 1) * self.length / SECTORS
        if moved <= 0 or self._beyond < boundary:
            return None
        at_s = last_s + (boundary - before) / moved * (t_s - last_s)
        if self._start_s is None:
            self._begin(at_s)
            return None
        self._splits.append(at_s - self._start_s)
        if len(self._splits) < SECTORS:
            return None
        self._beyond -= self.length
        lap = self._finish(self._start_s)
        self._begin(at_s)
        return lap

    def _finish(self, start_s: float) -> Lap:
        """The lap that ends here."""
        sectors = tuple(b - a for a, b in pairwise([0.0, *self._splits]))
        lap = Lap(len(self.laps) + 1, start_s, self._splits[-1], sectors, self._from_rest)
        self.laps.append(lap)
        if self.best is None or lap.time_s < self.best.time_s:
            self.best, self._best_line = lap, (self._stations, self._times)
        return lap
