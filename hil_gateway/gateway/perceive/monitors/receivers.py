"""Position fixes against the two receivers of race control, whose worth is learnt on the way.

Transponders report positions of their own: without corrections, late by a time that is
learnt, with an offset in the map that wanders by metres in minutes. A Kalman filter follows offset and lateness of
each (random walks; the readings are white beside them). How far their mean offset moves within some seconds is what
they are worth; where it moves by much more than it used to, and that of both the same way, it is the fixes that drift:
neither heading nor wheels can tell. For a ramp in a random walk the change of the filtered offset over the time since
its onset is the sum of the innovations, and with it what a likelihood ratio test goes by (M. Basseville and
I. Nikiforov, Detection of Abrupt Changes, 1993, ch. 7).
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from hil_gateway.car.car import Car, Receiver
from hil_gateway.config import OriginConfig
from hil_gateway.gateway.perceive.course import OLDEST_S
from hil_gateway.gateway.perceive.duration import UNSEEN_S, ConditionTime
from hil_gateway.gateway.perceive.positions.fixes import Fixes
from hil_gateway.gateway.perceive.vehicle_state import VehicleStateBuilder
from hil_gateway.process.arrays import Array
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.track.geodesy import LocalMap

LINE = 30
"""fixes: 1.5 s, as late as a receiver may be"""
CHORD = 2
"""fixes to either side between which the line's direction and speed are taken"""
STALE = 3.5
"""periods without a reading after which a receiver says nothing: three are lost"""
LATE_WALK = 1e-4**2
"""s2 by which the variance of the lateness grows a second"""
FIRST_LATE_S = 0.2
"""lateness before anything is learnt"""
FIRST_VARIANCES = (25.0, 25.0, 0.09)
"""of the offset (m2) and the lateness (s2) then"""
LATEST_S = 1.0
"""lateness at most; none is early"""
FAR_M = 1.5
"""m that a reading may lie from where it is expected once the filter has settled: beyond, the receiver has jumped or
hangs, and is learnt anew"""
SETTLED_M = 0.3
"""deviation of a settled offset"""
WINDOWS_S = (1.5, 3.0)
"""over which the offset's movement is judged: a drift of 0.5 m/s exceeds the bound of the shorter one, slower ones that
of the longer one"""
LEARNT = 0.0025
"""weight of a reading in the mean square of the movement: 40 s, so that a drift of seconds is not taken for worse
receivers"""
DEVIATIONS = 6.5
"""of the movement's own: with 2e5 independent readings in 20 h one of 5,000 such drives exceeds it"""
UNSURE = 2.0
"""by which the deviation of a lateness counts more: before the first braking offset and lateness look alike, and its
error lasts"""
OUTLYING = 2.0
"""deviations that one reading teaches at most"""
EITHER = 0.4
"""of the mean movement that each of both shows at least: it is not one of them that jumps"""


class _Line:
    """The newest fixes, and where they were at a time in between."""

    def __init__(self) -> None:
        self._fixes: deque[tuple[float, float, float]] = deque(maxlen=LINE)
        self._seq = 0

    def take(self, fixes: Fixes) -> None:
        """The fix of this period, if one came; across a gap there is no line."""
        if fixes.seq != self._seq:
            self._seq, t = fixes.seq, fixes.stamp_ns / NS_PER_S
            if self._fixes and t - self._fixes[-1][0] > UNSEEN_S:
                self._fixes.clear()
            self._fixes.append((t, fixes.x, fixes.y))

    @property
    def velocity(self) -> tuple[float, float]:
        """Of the newest of them, m/s in the map."""
        (t0, x0, y0), (t1, x1, y1) = self._fixes[-min(len(self._fixes), 1 + 2 * CHORD)], self._fixes[-1]
        span = max(t1 - t0, 1e-3)
        return (x1 - x0) / span, (y1 - y0) / span

    def at(self, t: float) -> tuple[float, float, float, float] | None:
        """Place (m) and velocity (m/s) in the map at `t` (s); None where no fixes are near."""
        fixes = self._fixes
        if len(fixes) <= 2 * CHORD or t < fixes[0][0] or t > fixes[-1][0] + OLDEST_S:
            return None
        after = len(fixes) - 1
        while after > 1 and fixes[after - 1][0] >= t:
            after -= 1
        (t0, x0, y0), (t1, x1, y1) = fixes[after - 1], fixes[after]
        share = (t - t0) / max(t1 - t0, 1e-3)
        (ta, xa, ya), (tb, xb, yb) = fixes[max(after - CHORD, 0)], fixes[min(after + CHORD - 1, len(fixes) - 1)]
        span = max(tb - ta, 1e-3)
        return x0 + share * (x1 - x0), y0 + share * (y1 - y0), (xb - xa) / span, (yb - ya) / span


class _Receiver:
    """One of them: its offset in the map, m, and its lateness, s."""

    def __init__(self, name: str, declared: Receiver, period_s: float, local_map: LocalMap) -> None:
        """`period_s` between two readings."""
        self._source, self._map = f"receiver.{name}", local_map
        self._latitude, self._longitude = (f"{self._source}.{name}" for name in ("latitude", "longitude"))
        self._stale_s, self._noise = STALE * period_s, declared.noise
        self.walk = 2.0 * declared.wander**2 / declared.wander_time
        """m2 by which the variance of the offset grows a second: that of its Gauss-Markov process"""
        self._stamp_ns: int | None = None
        self._read = (0.0, 0.0)
        self._begin()

    def _begin(self) -> None:
        """Nothing is known of it."""
        self._state: Array = np.array([0.0, 0.0, FIRST_LATE_S])
        self._covariance: Array = np.diag(FIRST_VARIANCES)
        self.speaks = True
        """whether its newest reading is fresh"""

    @property
    def settled(self) -> bool:
        """Whether its offset is known to `SETTLED_M`."""
        return bool(self._covariance[0, 0] < SETTLED_M**2)

    @property
    def offset(self) -> tuple[float, float]:
        """East and north, m."""
        return float(self._state[0]), float(self._state[1])

    @property
    def late_within_s(self) -> float:
        """Deviation of its lateness, s."""
        return math.sqrt(float(self._covariance[2, 2]))

    def step(self, now_ns: int, builder: VehicleStateBuilder, line: _Line) -> None:
        """Takes in a new reading, if there is one."""
        age_s = builder.age_s(self._source, now_ns)
        if age_s > self._stale_s:
            self.speaks = False
            return
        stamp_ns = now_ns - round(NS_PER_S * age_s)
        if stamp_ns == self._stamp_ns:
            return
        since_s = 0.0 if self._stamp_ns is None else (stamp_ns - self._stamp_ns) / NS_PER_S
        self._stamp_ns = stamp_ns
        read = self._map.to_map_radians(builder.value(self._latitude), builder.value(self._longitude))
        if read == self._read:
            self.speaks = False
            return
        self._read = read
        there = line.at(stamp_ns / NS_PER_S - float(self._state[2]))
        if there is not None:
            self._compare(read, there, since_s)

    def _compare(self, read: tuple[float, float], there: tuple[float, float, float, float], since_s: float) -> None:
        """One step of the filter: a reading is where the fixes were `lateness` before, and `offset` beside it."""
        x, y, east, north = there
        self._covariance = self._covariance + since_s * np.diag((self.walk, self.walk, LATE_WALK))
        differs = np.array([read[0] - x - self._state[0], read[1] - y - self._state[1]])
        if math.hypot(*differs) > FAR_M and self.settled:
            self._begin()
            return
        by = np.array([[1.0, 0.0, -east], [0.0, 1.0, -north]])
        gain = np.linalg.solve(by @ self._covariance @ by.T + self._noise**2 * np.eye(2), by @ self._covariance).T
        self._state = self._state + gain @ differs
        self._state[2] = min(max(self._state[2], 0.0), LATEST_S)
        self._covariance = self._covariance - gain @ by @ self._covariance
        self.speaks = True


Move = tuple[float, float]
"""m, or m/s, in the map, east and north"""


class _Window:
    """How far the mean offset moves within one window, against how far it usually does."""

    def __init__(self, window_s: float, walk: float) -> None:
        """`walk`: m2 that the variance of the mean offset grows a second, as declared: it counts at least."""
        self._least = DEVIATIONS * math.sqrt(walk * window_s)
        self._squares = [0.0, 0.0]
        """mean squares along and across the way, m2"""

    def share(self, moved: Move, late: Move, ahead: Move, learns: bool) -> float:
        """Of its bound that it has `moved`; `late` is the deviation of that for a lateness that is not known well,
        `ahead` the velocity of the way."""
        parts, of_lateness = _turned(moved, ahead), _turned(late, ahead)
        shares = [self._of_bound(axis, part, of_lateness[axis]) for axis, part in enumerate(parts)]
        if learns:
            for axis, (part, share) in enumerate(zip(parts, shares, strict=True)):
                most = min(1.0, OUTLYING / (DEVIATIONS * share + 1e-9))
                self._squares[axis] += LEARNT * ((most * part) ** 2 - self._squares[axis])
        return math.hypot(*shares)

    def _of_bound(self, axis: int, part: float, late: float) -> float:
        usual = max(DEVIATIONS**2 * self._squares[axis], self._least**2)
        return abs(part) / math.sqrt(usual + (DEVIATIONS * late) ** 2)


class OtherReceivers:
    """Whether the offsets of both have moved the same way by more than they do; never where the car has fewer."""

    def __init__(self, car: Car, origin: OriginConfig) -> None:
        local_map, signals = LocalMap(origin), car.codec.signals
        periods = {name: signals.reports[f"receiver.{name}.latitude"].message.period_s for name in car.receivers}
        _, *others = car.receivers
        self._receivers = [_Receiver(n, car.receivers[n], periods[n], local_map) for n in others[:2]]
        self._reading_s = max((periods[name] for name in others[:2]), default=1.0)
        self._line = _Line()
        self._kept: deque[tuple[Move, Move, Move]] = deque(maxlen=1 + round(max(WINDOWS_S) / self._reading_s))
        """offsets of both at the last readings, and velocity of the fixes"""
        walk = sum(receiver.walk for receiver in self._receivers) / 4.0
        self._windows = {round(window_s / self._reading_s): _Window(window_s, walk) for window_s in WINDOWS_S}
        self._next_ns = 0
        self._held = ConditionTime()
        self.share = 0.0
        """of the bound that the offsets have moved"""
        self.aside = (0.0, 0.0)
        """how far the fixes have led from the car since the oldest reading kept, m in the map"""

    def step(self, now_ns: int, builder: VehicleStateBuilder, learns: bool = True) -> float:
        """Seconds they have; once a period. They learn nothing from fixes that are not believed."""
        if len(self._receivers) < 2:
            return 0.0
        self._line.take(builder.fixes)
        for receiver in self._receivers:
            receiver.step(now_ns, builder, self._line)
        if now_ns >= self._next_ns:
            self._next_ns = now_ns + round(self._reading_s * NS_PER_S)
            self._judge(learns)
        return self._held.update(self.share > 1.0, now_ns)

    def _judge(self, learns: bool) -> None:
        one, other = self._receivers
        if not all(receiver.speaks and receiver.settled for receiver in self._receivers):
            self._kept.clear()
            self.share = 0.0
            return
        now = one.offset, other.offset, self._line.velocity
        if self._kept:
            self.aside = _minus(_mean(*self._kept[0][:2]), _mean(*now[:2]))
        if learns:
            self._kept.append(now)
        shares = [
            self._share(window, self._kept[-1 - back], now, learns)
            for back, window in self._windows.items()
            if len(self._kept) > back
        ]
        self.share = max(shares, default=0.0)

    def _share(self, window: _Window, before: tuple[Move, ...], now: tuple[Move, ...], learns: bool) -> float:
        """What one window shows of its bound; nothing where it is one receiver alone."""
        one, other, faster = (_minus(*pair) for pair in zip(now, before, strict=True))
        late_s = UNSURE * math.hypot(*(receiver.late_within_s for receiver in self._receivers)) / 2.0
        share = window.share(_mean(one, other), (late_s * faster[0], late_s * faster[1]), now[2], learns)
        return share if _alike(one, other) else 0.0


def _mean(one: Move, other: Move) -> Move:
    return 0.5 * (one[0] + other[0]), 0.5 * (one[1] + other[1])


def _minus(one: Move, other: Move) -> Move:
    return one[0] - other[0], one[1] - other[1]


def _turned(move: Move, ahead: Move) -> Move:
    """Along and across the direction `ahead`."""
    length = max(math.hypot(*ahead), 1e-9)
    east, north = ahead[0] / length, ahead[1] / length
    return east * move[0] + north * move[1], east * move[1] - north * move[0]


def _alike(one: Move, other: Move) -> bool:
    """Whether each of two movements is at least `EITHER` of their mean, and along it."""
    east, north = _mean(one, other)
    least = EITHER * (east**2 + north**2)
    return min(x * east + y * north for x, y in (one, other)) >= least
