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
from bisect import bisect_left, bisect_right
from collections import deque
from operator import itemgetter
from statistics import NormalDist
from typing import NamedTuple

from hil_gateway.car.car import Car
from hil_gateway.config import OriginConfig
from hil_gateway.gateway.perceive.course import OLDEST_S
from hil_gateway.gateway.perceive.duration import CONTRADICTED_S, UNSEEN_S, ConditionTime
from hil_gateway.gateway.perceive.positions.fixes import Fixes
from hil_gateway.gateway.perceive.vehicle_state import VehicleStateBuilder
from hil_gateway.observer.bank import CHANCE, GATE
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.track.geodesy import LocalMap

CHORD_S = CONTRADICTED_S
"""to either side of a time, over which the fixes tell the velocity"""
WINDOWS_S = (1.5, 3.0)
"""over which the offsets' movement is judged: a drift of 0.5 m/s exceeds the bound of the shorter one, slower ones that
of the longer one"""
BOTH = -NormalDist().inv_cdf(math.sqrt(CHANCE))
"""deviations that each of two exceeds by chance as rarely as one does `GATE`"""


Vector = tuple[float, float]
"""east and north, in the map"""


class _Line:
    """The newest fixes, and where they were at a time in between."""

    def __init__(self, latest_s: float) -> None:
        """`latest_s`: how old the places are at most that are asked for."""
        self._kept_s = latest_s + 2.0 * CHORD_S
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
        while self._fixes[0][0] < t - self._kept_s:
            self._fixes.popleft()

    def at(self, t: float) -> tuple[Vector, Vector] | None:
        """Place (m) and velocity (m/s) in the map at `t` (s); None where no fixes are near."""
        if not self._fixes or t - CHORD_S < self._fixes[0][0] or t > self._fixes[-1][0] + OLDEST_S:
            return None
        later = min(t + CHORD_S, self._fixes[-1][0])
        (x0, y0), place, (x1, y1) = (self._place(time) for time in (later - 2.0 * CHORD_S, t, later))
        return place, ((x1 - x0) / (2.0 * CHORD_S), (y1 - y0) / (2.0 * CHORD_S))

    def _place(self, t: float) -> Vector:
        """Between the two fixes around `t`, else at the first or the newest one."""
        after = bisect_right(self._fixes, t, key=itemgetter(0))
        (t0, x0, y0), (t1, x1, y1) = self._fixes[max(after - 1, 0)], self._fixes[min(after, len(self._fixes) - 1)]
        share = (t - t0) / (t1 - t0) if t0 < t < t1 else 0.0
        return x0 + share * (x1 - x0), y0 + share * (y1 - y0)


class _Spread(NamedTuple):
    """Symmetrical matrix of two dimensions: a covariance, m2."""

    xx: float
    xy: float
    yy: float

    def along(self, x: float, y: float) -> float:
        """Its quadratic form."""
        return self.xx * x * x + 2.0 * self.xy * x * y + self.yy * y * y

    def solve(self, x: float, y: float) -> Vector:
        """What it makes (x, y) of."""
        determinant = self.xx * self.yy - self.xy * self.xy
        return (self.yy * x - self.xy * y) / determinant, (self.xx * y - self.xy * x) / determinant


class _Known(NamedTuple):
    """What is known of an offset (m, east and north) at a time (s), and with what covariance."""

    t: float
    offset: Vector
    spread: _Spread


class _Receiver:
    """One of them: its offset in the map, m, and its lateness, s."""

    def __init__(self, name: str, car: Car, local_map: LocalMap) -> None:
        self._source, self._map, self._declared = f"receiver.{name}", local_map, car.receivers[name]
        self._latitude, self._longitude = (f"{self._source}.{name}" for name in ("latitude", "longitude"))
        self._wander = self._declared.wander + car.std(f"receiver.{name}.wander")
        self._late = self._declared.delay, car.std(f"receiver.{name}.delay")
        self.latest_s = self._declared.delay + GATE * car.std(f"receiver.{name}.delay")
        self._walk = 2.0 * self._wander**2 / self._declared.wander_time
        """m2 that the variance of the offset grows a second, of a receiver that is a deviation worse than declared"""
        self._stamp_ns: int | None = None
        self._read = (0.0, 0.0)
        self._kept: deque[_Known] = deque()
        self._begin()

    def _begin(self) -> None:
        """Nothing is known of it."""
        self._offset, self._late_s = (0.0, 0.0), self._late[0]
        self._spread = _Spread(self._wander**2, 0.0, self._wander**2)
        self._with_late, self._late_variance = (0.0, 0.0), self._late[1] ** 2
        """covariances of the offset with the lateness, m s, and its variance, s2"""
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
        there = line.at(stamp_ns / NS_PER_S - self._late_s) if read != self._read else None
        self._read = read
        if there is None:  # it hangs, or there are no fixes
            self._kept.clear()
            return False
        self._compare(read, *there, since_s)
        self._kept.append(_Known(stamp_ns / NS_PER_S, self._offset, self._spread))
        while self._kept[-1].t - self._kept[0].t > WINDOWS_S[-1]:
            self._kept.popleft()
        return True

    def _compare(self, read: Vector, place: Vector, velocity: Vector, since_s: float) -> None:
        """One step of the filter: a reading is where the fixes were `lateness` before, and `offset` beside it."""
        (xl, yl), ll, (vx, vy) = self._with_late, self._late_variance, velocity
        grown = self._walk * since_s
        xx, xy, yy = self._spread.xx + grown, self._spread.xy, self._spread.yy + grown
        # covariances of offset and lateness with what is read, east and north
        east = xx - vx * xl, xy - vx * yl, xl - vx * ll
        north = xy - vy * xl, yy - vy * yl, yl - vy * ll
        noise = self._declared.noise**2
        spread = _Spread(east[0] - vx * east[2] + noise, north[0] - vx * north[2], north[1] - vy * north[2] + noise)
        dx, dy = read[0] - place[0] - self._offset[0], read[1] - place[1] - self._offset[1]
        weighed_x, weighed_y = spread.solve(dx, dy)
        if dx * weighed_x + dy * weighed_y > GATE**2:  # it has jumped
            self._begin()
            return
        by_x, by_y, by_late = ((e * weighed_x + n * weighed_y) for e, n in zip(east, north, strict=True))
        self._offset = self._offset[0] + by_x, self._offset[1] + by_y
        self._late_s = min(max(self._late_s + by_late, 0.0), self.latest_s)
        gains = [spread.solve(e, n) for e, n in zip(east, north, strict=True)]
        taken = [[gx * e + gy * n for e, n in zip(east, north, strict=True)] for gx, gy in gains]
        self._spread = _Spread(xx - taken[0][0], xy - taken[0][1], yy - taken[1][1])
        self._with_late, self._late_variance = (xl - taken[0][2], yl - taken[1][2]), ll - taken[2][2]

    @property
    def speaks(self) -> bool:
        """Whether its newest reading is fresh."""
        return bool(self._kept)

    def moved(self, window_s: float) -> tuple[Vector, _Spread]:
        """How far the filter has moved the offset within a window, m, and with what covariance chance does that: by
        what has become more certain since then, and what the offset wanders."""
        now = self._kept[-1]
        before = self._kept[bisect_left(self._kept, -window_s, key=lambda known: known.t - now.t)]
        wandered, was, spread = (now.t - before.t) * self._walk, before.spread, now.spread
        chance = _Spread(was.xx - spread.xx + wandered, was.xy - spread.xy, was.yy - spread.yy + wandered)
        return (now.offset[0] - before.offset[0], now.offset[1] - before.offset[1]), chance


class OtherReceivers:
    """Whether the offsets of both have moved the same way by more than they do; never where the car has fewer."""

    def __init__(self, car: Car, origin: OriginConfig) -> None:
        local_map = LocalMap(origin)
        _, *others = car.receivers
        self._receivers = [_Receiver(name, car, local_map) for name in others[:2]]
        self._line = _Line(max((receiver.latest_s for receiver in self._receivers), default=0.0))
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
        (one, _), (other, _) = both
        x, y = one[0] + other[0], one[1] + other[1]
        way = math.hypot(x, y)
        if way == 0.0:
            return 0.0
        variances = [chance.along(x / way, y / way) for _, chance in both]
        if min(variances) <= 0.0:  # a first reading has moved nothing
            return 0.0
        ahead = [(x * moved[0] + y * moved[1]) / way for moved, _ in both]
        return min(a / math.sqrt(variance) for a, variance in zip(ahead, variances, strict=True)) / BOTH
