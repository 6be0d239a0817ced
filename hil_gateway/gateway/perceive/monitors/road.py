"""Where the car is on the track: off the road, far from it, or against its direction."""

from __future__ import annotations

import math

from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.gateway.perceive.dead_reckoning import Pose
from hil_gateway.gateway.perceive.duration import ConditionTime
from hil_gateway.track.track import Track

BEYOND = 0.5
"""m a wheel may be over the edge: error of the position and of the map"""
NEAR = 30.0
"""m off the centre line: nearer, the last arc length finds the next one; further off, no way leads back"""
ACROSS = math.radians(60.0)
"""between the directions of track and car: neither of a car that follows it nor of a slide it recovers from"""


class RoadMonitor:
    """Seconds off road and pit lane, and against their direction, by the reckoned pose."""

    def __init__(self, track: Track, half_width: float) -> None:
        self._track, self._half_width = track, half_width
        self._s: float | None = None
        self._off, self._against = ConditionTime(), ConditionTime()
        self.gravity_across = 0.0
        """specific force to the left that gravity makes on the bank where the car is, m/s2"""

    def step(self, now_ns: int, pose: Pose | None) -> tuple[float, float]:
        """(off the road, wrong way), s."""
        if pose is None:
            self._s = None
            return self._off.update(False, now_ns), self._against.update(False, now_ns)
        track = self._track
        s, lateral = track.project(pose.x, pose.y, self._s)
        self._s = s if abs(lateral) < NEAR else None
        i = min(int(s / track.length * len(track.s)), len(track.s) - 1)
        self.gravity_across = GRAVITY * math.sin(float(track.bank[i]))
        off = not track.holds(s, lateral, self._half_width - BEYOND)
        against = not abs(math.remainder(pose.yaw - float(track.heading[i]), math.tau)) < ACROSS
        return self._off.update(off, now_ns), self._against.update(against, now_ns)
