"""Whether a receiver's positions go on from one to the next: repeats, hangs, jumps. Pure.

A jump is one refused position: the next one goes on from where it led. What is wrong for longer only others can tell
(`hil_gateway/gateway/perceive/monitors/position.py`).
"""

from __future__ import annotations

import math

from hil_gateway.bus.outside import Place, Velocity
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.receiver.solution import Solution
from hil_gateway.track.geodesy import SEMI_MAJOR_AXIS

DEVIATIONS = 6.0
"""of two positions and the way between them, within which a position lies: one in 5e8 is refused by chance"""
LEAST_M = 0.05
"""deviation that counts at least: states of their own worth are optimistic, and quantised"""
HARDEST = 40.0
"""m/s2 by which the velocity may change on the way: half of what a race car does twice over"""
COMPARED_S = 0.5
"""longest time between two positions, and to the velocity between, that are compared"""
MOVING = 1.0
"""m/s: two positions alike to the last bit are then one position sent twice"""


class Continuity:
    """Of one receiver; `judge` every solution with good status, in order."""

    def __init__(self) -> None:
        self._newest_ns: dict[str, int] = {}
        """of each kind of log"""
        self._places: dict[str, tuple[int, Place]] = {}
        self._velocity: tuple[int, Velocity] | None = None

    def judge(self, solution: Solution) -> str:
        """Why it is refused; empty: it goes on."""
        before_ns = self._newest_ns.get(solution.log)
        if before_ns is not None and before_ns - NS_PER_S < solution.gps_ns <= before_ns:
            return "repeated"
        self._newest_ns[solution.log] = solution.gps_ns
        if solution.velocity is not None:
            self._velocity = solution.gps_ns, solution.velocity
        return "" if solution.place is None else self._of_place(solution.log, solution.gps_ns, solution.place)

    def _of_place(self, log: str, gps_ns: int, place: Place) -> str:
        before, self._places[log] = self._places.get(log), (gps_ns, place)
        if before is None or self._velocity is None:
            return ""
        dt, since = (gps_ns - before[0]) / NS_PER_S, abs(gps_ns - self._velocity[0]) / NS_PER_S
        if dt > COMPARED_S or since > COMPARED_S:
            return ""
        east, north = _way(before[1], place)
        velocity = self._velocity[1]
        if math.hypot(velocity.east, velocity.north) > MOVING and east == north == 0.0:
            return "hangs"
        off = math.hypot(east - velocity.east * dt, north - velocity.north * dt)
        within = DEVIATIONS * math.hypot(*_deviations(before[1]), *_deviations(place), (velocity.std or 0.0) * dt)
        return "" if off <= within + HARDEST * dt * (dt + since) else "jumps"


def _deviations(place: Place) -> tuple[float, float]:
    return max(place.std_east or 0.0, LEAST_M), max(place.std_north or 0.0, LEAST_M)


def _way(before: Place, after: Place) -> tuple[float, float]:
    """East and north, m, on a sphere: right within 1 % of the way."""
    north = SEMI_MAJOR_AXIS * math.radians(after.latitude - before.latitude)
    turned = math.radians(math.remainder(after.longitude - before.longitude, 360.0))
    return SEMI_MAJOR_AXIS * math.cos(math.radians(before.latitude)) * turned, north
