"""The newest position fixes, and how the car moves by them alone: independent of the wheels."""

from __future__ import annotations

from collections import deque

import numpy as np

from hil_gateway.car.car import Car
from hil_gateway.gateway.perceive.course import COURSE_WINDOW, LEAST_FIXES, OLDEST_S, Course, Parabola
from hil_gateway.gateway.perceive.duration import UNSEEN_S
from hil_gateway.observer.bank import GATE
from hil_gateway.observer.observer import SLOWEST
from hil_gateway.process.arrays import Array
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.settings.gateway import PERIOD_S

MOVING = 5.0
"""m/s: slower, the way between fixes is no longer than what they may be apart"""


def latest_s(car: Car, receiver: str) -> float:
    """By how much a receiver on the bus is late at most, s."""
    return car.receivers[receiver].delay + GATE * car.std(f"receiver.{receiver}.delay")


class Fixes:
    """Position in the local map, m, its number and when it came."""

    def __init__(self, noise: float, late_s: float = 0.0) -> None:
        """`noise` of a fix, m; `late_s`: how old the places are at most that are asked for."""
        self.noise = noise
        self._kept_ns = round((late_s + LEAST_FIXES * UNSEEN_S) * NS_PER_S)
        """those of a course, as seldom as they may come, before that"""
        self.x = self.y = 0.0
        self.seq = self.stamp_ns = self._row = 0
        self._step = 0j
        self._newest: deque[tuple[int, complex]] = deque()
        """stamp and place: x + i y, m; across a gap there is no line"""
        self._fitting = list(self._newest)
        """those that a course is fitted to"""
        self._fit: Parabola | None = None
        """of time since the newest fix, s"""

    def take(self, x: float, y: float, stamp_ns: int) -> None:
        """The next fix."""
        if stamp_ns - self.stamp_ns > UNSEEN_S * NS_PER_S:
            self._newest.clear()
        step, least = complex(x - self.x, y - self.y), MOVING * (stamp_ns - self.stamp_ns) / NS_PER_S
        same_way = (step * self._step.conjugate()).real > 0.0
        self._row = self._row + 1 if same_way and abs(step) > least else 0
        self._step, self.x, self.y, self.stamp_ns, self.seq = step, x, y, stamp_ns, self.seq + 1
        self._newest.append((stamp_ns, complex(x, y)))
        while self._newest[0][0] < stamp_ns - self._kept_ns:
            self._newest.popleft()
        since_ns = stamp_ns - round(COURSE_WINDOW * PERIOD_S * NS_PER_S)
        within = sum(stamp > since_ns for stamp, _ in self._newest)
        self._fitting = list(self._newest)[-max(within, LEAST_FIXES) :]
        self._fit = self._fitted() if within < len(self._newest) else None

    @property
    def moving(self) -> bool:
        """Whether the last ones each lead further on: a jump of the receiver is one, and noise turns back."""
        return self._row >= max(len(self._fitting), LEAST_FIXES)

    def course(self, now_ns: int) -> Course | None:
        """At `now_ns`; None where fixes are missing, slow or scattered."""
        since_s = (now_ns - self.stamp_ns) / NS_PER_S
        return None if self._fit is None or since_s > OLDEST_S else self._fit.course(since_s)

    def line(self) -> tuple[Array, Array]:
        """Times (n,), s, and places (n,), x + i y in m."""
        return np.array([stamp / NS_PER_S for stamp, _ in self._newest]), np.array([place for _, place in self._newest])

    def _fitted(self) -> Parabola | None:
        times, places = (np.array(column) for column in zip(*self._fitting, strict=True))
        since = (times - self.stamp_ns) / NS_PER_S
        if len(times) < LEAST_FIXES or (np.diff(times) <= 0).any():
            return None
        fit = Parabola.fitted(since, places, self.noise)
        slow = abs(fit.velocity) < SLOWEST
        return None if slow or fit.scatter(since, places, self.noise) > 1.0 else fit
