"""Where the car is on the track: off the road, far from it, or against its direction."""

from __future__ import annotations

import math

from hil_gateway.car.vehicle import GRAVITY, HALF_WIDTH
from hil_gateway.gateway.perceive.dead_reckoning import Pose
from hil_gateway.gateway.perceive.monitors.held import Held
from hil_gateway.gateway.perceive.road_speed import STANDSTILL
from hil_gateway.track.track import Track

BEYOND = 0.5
"""m a wheel may be over the edge: error of the position and of the map"""
NEAR = 60.0
"""m: nearer, the last arc length finds the next one"""
PIT_M = 30.0
"""m beside the edge where a pit lane may lie: maps of a track do not show it"""
PIT_SPEED = 20.0
"""m/s: no pit lane is driven faster"""


class RoadMonitor:
    """Seconds off the road and against its direction, by the reckoned pose.

    A car that stood beside the road, within `PIT_M`, comes from a pit lane: up to `PIT_SPEED` it is not off the road
    until it has been on it.
    """

    def __init__(self, track: Track) -> None:
        self._track = track
        self._s: float | None = None
        self._from_pit = False
        self._off, self._against = Held(), Held()
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
        edge = float(track.width_left[i] if lateral > 0 else track.width_right[i])
        beside_m = abs(lateral) - edge + HALF_WIDTH - BEYOND
        self._from_pit = 0.0 <= beside_m < PIT_M and (self._from_pit or pose.speed < STANDSTILL)
        off = not beside_m < 0.0 and not (self._from_pit and pose.speed < PIT_SPEED)
        against = math.cos(pose.yaw - float(track.heading[i])) < 0.0
        return self._off.update(off, now_ns), self._against.update(against, now_ns)
