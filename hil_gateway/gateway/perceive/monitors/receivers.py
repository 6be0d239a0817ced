"""Position fixes against the two receivers of race control.

Transponders report positions of their own: without corrections, late by a time that is learnt, with an offset in the
map that wanders by metres in minutes. A Kalman filter follows offset (its declared Gauss-Markov process, short-term)
and lateness of each. Where the offsets of both move the same way, each by more than chance explains, it is the fixes
that drift: neither heading nor wheels can tell. For a ramp in a random walk the change of the filtered offset over the
time since its onset is the sum of the innovations, and with it what a likelihood ratio test goes by (M. Basseville and
I. Nikiforov, Detection of Abrupt Changes, 1993, ch. 7).
"""

from __future__ import annotations

import math
from collections import deque
from statistics import NormalDist
from typing import NamedTuple

import numpy as np

from hil_gateway.car.car import Car
from hil_gateway.config import OriginConfig
from hil_gateway.gateway.perceive.course import OLDEST_S
from hil_gateway.gateway.perceive.duration import UNSEEN_S, ConditionTime
from hil_gateway.gateway.perceive.positions.fixes import Fixes
from hil_gateway.gateway.perceive.vehicle_state import VehicleStateBuilder
from hil_gateway.observer.bank import CHANCE, GATE
from hil_gateway.process.arrays import Array
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.track.geodesy import LocalMap

LATE_S = (0.2, 0.3)
"""lateness before anything is learnt, and its standard deviation"""
LATEST_S = 1.0
"""lateness at most, and chord of the fixes: 0.1 s to either side of a time"""
CHORD_S = 0.1
WINDOWS_S = (1.5, 3.0)
"""over which the offsets' movement is judged: a drift of 0.5 m/s exceeds the bound of the shorter one, slower ones that
of the longer one"""
BOTH = NormalDist().inv_cdf(1.0 - math.sqrt(CHANCE))
"""deviations that each of two exceeds by chance as rarely as one does `GATE`"""


class _Line:
    """The newest fixes, and where they were at a time in between."""

    def __init__(self) -> None:
        self._fixes: deque[tuple[float, float, float]] = deque()
        self._seq = 0

    def take(self, fixes: Fixes) -> None:
        """The fix of this period, if one came; across a gap there is no line."""
        if fixes.seq == self._seq:
            return
        self._seq, t = fixes.seq, fixes.stamp_ns / NS_PER_S
        if self._fixes and t - self._fixes[-1][0] > UNSEEN_S:
            self._fixes.clear()
        self._fixes.append((t, fixes.x, fixes.y))
        while self._fixes[0][0] < t - LATEST_S - 2.0 * CHORD_S:
            self._fixes.popleft()

    def at(self, t: float) -> tuple[Array, Array] | None:
        """Place (m) and velocity (m/s) in the map at `t` (s); None where no fixes are near."""
        times, x, y = zip(*self._fixes, strict=True) if self._fixes else ((), (), ())
        if not times or t - CHORD_S < times[0] or t > times[-1] + OLDEST_S:
            return None
        later = min(t + CHORD_S, times[-1])
        at = [later - 2.0 * CHORD_S, t, later]
        before, place, after = np.array([np.interp(at, times, x), np.interp(at, times, y)]).T
        return place, (after - before) / (2.0 * CHORD_S)


class _Known(NamedTuple):
    """What is known of an offset (m, east and north) at a time (s), and with what covariance."""

    t: float
    offset: Array
    covariance: Array


class _Receiver:
    """One of them: its offset in the map, m, and its lateness, s."""

    def __init__(self, name: str, car: Car, local_map: LocalMap) -> None:
        self._source, self._map, self._declared = f"receiver.{name}", local_map, car.receivers[name]
        self._latitude, self._longitude = (f"{self._source}.{name}" for name in ("latitude", "longitude"))
        self._wander = self._declared.wander + car.std(f"receiver.{name}.wander")
        self._walk = 2.0 * self._wander**2 / self._declared.wander_time
        """m2 that the variance of the offset grows a second, of a receiver that is a deviation worse than declared"""
        self._stamp_ns: int | None = None
        self._read = (0.0, 0.0)
        self._kept: deque[_Known] = deque()
        self._begin()

    def _begin(self) -> None:
        """Nothing is known of it."""
        self._state: Array = np.array([0.0, 0.0, LATE_S[0]])
        self._covariance: Array = np.diag([self._wander**2] * 2 + [LATE_S[1] ** 2])
        self._kept.clear()

    def step(self, now_ns: int, builder: VehicleStateBuilder, line: _Line) -> bool:
        """Takes in a new reading; whether there is one."""
        age_s = builder.age_s(self._source, now_ns)
        if age_s > UNSEEN_S:
            self._kept.clear()
            return False
        stamp_ns = now_ns - round(NS_PER_S * age_s)
        if stamp_ns == self._stamp_ns:
            return False
        since_s = 0.0 if self._stamp_ns is None else (stamp_ns - self._stamp_ns) / NS_PER_S
        self._stamp_ns = stamp_ns
        read = self._map.to_map_radians(builder.value(self._latitude), builder.value(self._longitude))
        there = line.at(stamp_ns / NS_PER_S - float(self._state[2])) if read != self._read else None
        self._read = read
        if there is None:  # it hangs, or there are no fixes
            self._kept.clear()
            return False
        self._compare(np.array(read), *there, since_s)
        self._kept.append(_Known(stamp_ns / NS_PER_S, self._state[:2].copy(), self._covariance[:2, :2]))
        while self._kept[-1].t - self._kept[0].t > WINDOWS_S[-1]:
            self._kept.popleft()
        return True

    def _compare(self, read: Array, place: Array, velocity: Array, since_s: float) -> None:
        """One step of the filter: a reading is where the fixes were `lateness` before, and `offset` beside it."""
        self._covariance = self._covariance + since_s * np.diag([self._walk, self._walk, 0.0])
        by = np.column_stack([np.eye(2), -velocity])
        differs = read - place - self._state[:2]
        spread = by @ self._covariance @ by.T + self._declared.noise**2 * np.eye(2)
        if differs @ np.linalg.solve(spread, differs) > GATE**2:  # it has jumped
            self._begin()
            return
        gain = np.linalg.solve(spread, by @ self._covariance).T
        self._state = self._state + gain @ differs
        self._state[2] = min(max(self._state[2], 0.0), LATEST_S)
        self._covariance = self._covariance - gain @ by @ self._covariance

    @property
    def speaks(self) -> bool:
        """Whether its newest reading is fresh."""
        return bool(self._kept)

    def moved(self, window_s: float) -> tuple[Array, Array]:
        """How far the filter has moved the offset within a window, m, and with what covariance chance does that: by
        what has become more certain since then, and what the offset wanders."""
        now = self._kept[-1]
        before = next(known for known in self._kept if now.t - known.t <= window_s)
        chance = before.covariance - now.covariance + (now.t - before.t) * self._walk * np.eye(2)
        return now.offset - before.offset, chance


class OtherReceivers:
    """Whether the offsets of both have moved the same way by more than they do; never where the car has fewer."""

    def __init__(self, car: Car, origin: OriginConfig) -> None:
        local_map = LocalMap(origin)
        _, *others = car.receivers
        self._receivers = [_Receiver(name, car, local_map) for name in others[:2]]
        self._line = _Line()
        self._held = ConditionTime()
        self.share = 0.0
        """of what chance explains that the offsets have moved"""

    def step(self, now_ns: int, builder: VehicleStateBuilder) -> float:
        """Seconds they have; once a period."""
        if len(self._receivers) < 2:
            return 0.0
        self._line.take(builder.fixes)
        came = [receiver for receiver in self._receivers if receiver.step(now_ns, builder, self._line)]
        speak = all(receiver.speaks for receiver in self._receivers)
        if came or not speak:
            self.share = max(map(self._judge, WINDOWS_S)) if speak else 0.0
        return self._held.update(self.share > 1.0, now_ns)

    def _judge(self, window_s: float) -> float:
        """Of the bound, what the one shows that has moved less the way of both."""
        both = [receiver.moved(window_s) for receiver in self._receivers]
        way = both[0][0] + both[1][0]
        if not way.any():
            return 0.0
        ahead = way / np.hypot(*way)
        variances = [float(ahead @ chance @ ahead) for _, chance in both]
        if min(variances) <= 0.0:  # a first reading has moved nothing
            return 0.0
        return min(float(ahead @ both[i][0]) / math.sqrt(variance) for i, variance in enumerate(variances)) / BOTH
