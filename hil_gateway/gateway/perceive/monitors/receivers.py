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
from bisect import bisect_left
from collections import deque
from statistics import NormalDist
from typing import NamedTuple

import numpy as np

from hil_gateway.car.car import Car
from hil_gateway.config import OriginConfig
from hil_gateway.gateway.perceive.course import OLDEST_S
from hil_gateway.gateway.perceive.duration import CONTRADICTED_S, UNSEEN_S, ConditionTime
from hil_gateway.gateway.perceive.positions.fixes import Fixes, latest_s
from hil_gateway.gateway.perceive.vehicle_state import VehicleStateBuilder
from hil_gateway.observer.bank import CHANCE, GATE
from hil_gateway.process.arrays import Array
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.track.geodesy import LocalMap

CHORD_S = CONTRADICTED_S
"""to either side of a time, over which the fixes tell the velocity"""
WINDOWS_S = (1.5, 3.0)
"""over which the offsets' movement is judged: a drift of 0.5 m/s exceeds the bound of the shorter one, slower ones that
of the longer one"""
BOTH = -NormalDist().inv_cdf(math.sqrt(CHANCE))
"""deviations that each of two exceeds by chance as rarely as one does `GATE`"""


def _there(fixes: Fixes, t: float) -> tuple[Array, Array] | None:
    """Place (m) and velocity (m/s) in the map by the fixes at `t` (s), (2,) each; None where none are near.

    The velocity is less by what noise may make of it: a car that stands would seem to move, and its receivers to be
    late by what noise says.
    """
    times, places = fixes.line()
    if not len(times) or t - CHORD_S < times[0] or t > times[-1] + OLDEST_S:
        return None
    later = min(t + CHORD_S, times[-1])
    east_north = np.array([[z.real, z.imag] for z in np.interp([t, later - 2.0 * CHORD_S, later], times, places)])
    way = east_north[2] - east_north[1]
    noise, length = math.sqrt(2.0) * GATE * fixes.noise, math.hypot(*way)
    return east_north[0], way / (2.0 * CHORD_S) * (1.0 - (noise / max(length, noise)) ** 2)


class _Known(NamedTuple):
    """What is known at a time (s) of an offset (m, east and north) and a lateness (s): mean (3,), covariance (3, 3)."""

    t: float
    mean: Array
    covariance: Array

    def after(self, by: Array, value: float, variance: float) -> tuple[_Known, float]:
        """With one number read that is `by` (3,) times them: a step of a Kalman filter; and how far it was off,
        squared, over its variance."""
        gains = self.covariance @ by
        whole, off = variance + float(gains @ by), value - float(self.mean @ by)
        covariance = self.covariance - np.outer(gains, gains) / whole
        return _Known(self.t, self.mean + gains * off / whole, covariance), off * off / whole


class _Receiver:
    """One of them: its offset in the map, m, and its lateness, s."""

    def __init__(self, name: str, car: Car, local_map: LocalMap) -> None:
        self._source, self._map, self._declared = f"receiver.{name}", local_map, car.receivers[name]
        self._latitude, self._longitude = (f"{self._source}.{name}" for name in ("latitude", "longitude"))
        self._wander = self._declared.wander + car.std(f"receiver.{name}.wander")
        self._late = self._declared.delay, car.std(f"receiver.{name}.delay")
        self.latest_s = latest_s(car, name)
        self._walk = 2.0 * self._wander**2 / self._declared.wander_time
        """m2 that the variance of the offset grows a second, of a receiver that is a deviation worse than declared"""
        self._stamp_ns: int | None = None
        self._read = 0.0, 0.0
        self._kept: deque[_Known] = deque()
        self._begin()

    def _begin(self) -> None:
        """Nothing is known of it."""
        late_s, std_s = self._late
        covariance = np.diag([self._wander**2, self._wander**2, std_s**2])
        self._known = _Known(0.0, np.array([0.0, 0.0, late_s]), covariance)
        self._unfit_s = 0.0
        """for which no reading has been near what was known"""
        self._kept.clear()

    def step(self, now_ns: int, builder: VehicleStateBuilder) -> bool:
        """Takes in a new reading; whether there is one."""
        age_s = builder.age_s(self._source, now_ns)
        if age_s > UNSEEN_S:
            self._kept.clear()
            return False
        stamp_ns = now_ns - round(NS_PER_S * age_s)
        if stamp_ns == self._stamp_ns:
            return False
        t, since_s = stamp_ns / NS_PER_S, 0.0 if self._stamp_ns is None else (stamp_ns - self._stamp_ns) / NS_PER_S
        self._stamp_ns = stamp_ns
        read = self._map.to_map_radians(builder.value(self._latitude), builder.value(self._longitude))
        there = _there(builder.fixes, t - self._known.mean[2]) if read != self._read else None
        self._read = read
        if there is None:  # it hangs, or there are no fixes
            self._kept.clear()
            return False
        self._compare(np.array(read), *there, since_s)
        self._kept.append(self._known._replace(t=t))
        while self._kept[-1].t - self._kept[0].t > WINDOWS_S[-1]:
            self._kept.popleft()
        return True

    def _compare(self, read: Array, place: Array, velocity: Array, since_s: float) -> None:
        """One step of the filter: a reading is where the fixes were `lateness` before, and `offset` beside it."""
        _, mean, covariance = self._known
        grown = np.diag([self._walk * since_s, self._walk * since_s, 0.0])
        known, off = _Known(0.0, mean, covariance + grown), 0.0
        beside = read - place - velocity * mean[2]
        for value, by in zip(beside, np.column_stack([np.eye(2), -velocity]), strict=True):
            known, more = known.after(by, float(value), self._declared.noise**2)
            off += more
        if off > GATE**2:
            self._refuse(since_s, covariance + grown)
            return
        known.mean[2] = min(max(known.mean[2], 0.0), self.latest_s)
        self._known, self._unfit_s = known, 0.0

    def _refuse(self, since_s: float, covariance: Array) -> None:
        """One that is off: it, or the fix that it is compared with, has waited somewhere; or it has jumped for good."""
        self._known = self._known._replace(covariance=covariance)
        self._unfit_s += since_s
        if self._unfit_s > UNSEEN_S:
            self._begin()

    @property
    def speaks(self) -> bool:
        """Whether its newest reading is fresh."""
        return bool(self._kept)

    def before(self, window_s: float) -> _Known:
        """What was known at the beginning of a window."""
        return self._kept[bisect_left(self._kept, -window_s, key=lambda known: known.t - self._kept[-1].t)]

    def moved(self, window_s: float) -> Array:
        """How far the filter has moved the offset since then, m, (2,)."""
        return self._kept[-1].mean[:2] - self.before(window_s).mean[:2]

    def by_chance(self, window_s: float, way: Array) -> float:
        """With what variance chance moves it in a direction (2,), m2: by what has become more certain since then, and
        what the offset wanders."""
        before, now = self.before(window_s), self._kept[-1]
        surer = (before.covariance - now.covariance)[:2, :2]
        return float(way @ surer @ way) + (now.t - before.t) * self._walk


class OtherReceivers:
    """Whether the offsets of both have moved the same way by more than they do; never where the car has fewer."""

    def __init__(self, car: Car, origin: OriginConfig) -> None:
        local_map = LocalMap(origin)
        _, *others = car.receivers
        self._receivers = [_Receiver(name, car, local_map) for name in others[:2]]
        self._held = ConditionTime()
        self.share = 0.0
        """of what chance explains that the offsets have moved"""

    def step(self, now_ns: int, builder: VehicleStateBuilder) -> float:
        """Seconds they have; once a period."""
        if len(self._receivers) < 2:
            return 0.0
        came = [receiver for receiver in self._receivers if receiver.step(now_ns, builder)]
        speak = all(receiver.speaks for receiver in self._receivers)
        if came or not speak:
            self.share = max(map(self._judge, WINDOWS_S)) if speak else 0.0
        return self._held.update(self.share > 1.0, now_ns)

    def _judge(self, window_s: float) -> float:
        """Of the bound, what the one shows that has moved less the way of both."""
        both = np.array([receiver.moved(window_s) for receiver in self._receivers])
        way = both.sum(axis=0)
        length = math.hypot(*way)
        if length == 0.0:
            return 0.0
        variances = np.array([receiver.by_chance(window_s, way / length) for receiver in self._receivers])
        if variances.min() <= 0.0:  # a first reading has moved nothing
            return 0.0
        return float((both @ way / length / np.sqrt(variances)).min()) / BOTH
