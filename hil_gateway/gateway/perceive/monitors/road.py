"""Where the car is on the track: off the road, far from it, or against its direction."""

from __future__ import annotations

import math

from hil_gateway.gateway.perceive.dead_reckoning import Pose
from hil_gateway.gateway.perceive.monitors.held import Held
from hil_gateway.track.track import Track

HALF_WIDTH = 0.95
"""m from the middle of the car to the outside of its wheels"""
BEYOND = 0.5
"""m a wheel may be over the edge: error of the position and of the map"""
NEAR = 60.0
"""m: nearer, the last arc length finds the next one"""


class RoadMonitor:
    """Seconds off the road and against its direction, by the reckoned pose."""

    def __init__(self, track: Track) -> None:
        self._track = track
        self._s: float | None = None
        self._off, self._against = Held(), Held()

    def step(self, now_ns: int, pose: Pose | None) -> tuple[float, float]:
        """(off the road, wrong way), s."""
        if pose is None:
            self._s = None
            return self._off.update(False, now_ns), self._against.update(False, now_ns)
        track = self._track
        s, lateral = track.project(pose.x, pose.y, self._s)
        self._s = s if abs(lateral) < NEAR else None
        i = min(int(s / track.length * len(track.s)), len(track.s) - 1)
        edge = float(track.width_left[i] if lateral > 0 else track.width_right[i])
        off = not abs(lateral) < edge - HALF_WIDTH + BEYOND
        against = math.cos(pose.yaw - float(track.heading[i])) < 0.0
        return self._off.update(off, now_ns), self._against.update(against, now_ns)
