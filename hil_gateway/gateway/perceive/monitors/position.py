"""Position fixes against the way the car has gone by wheels and gyro since the last fix that agreed.

A step, a receiver that repeats its last fix, a delay, noise of a lost correction service and a second sender all put
fixes where the car cannot have gone. A slow drift (below 8 % of the speed) does not: nothing on board is independent
of the one receiver over minutes, so it shows only when the fixes lead off the road.
"""

from __future__ import annotations

import math

from hil_gateway.bus.messages import VehicleState
from hil_gateway.gateway.perceive.dead_reckoning import Pose
from hil_gateway.gateway.perceive.motion import Motion
from hil_gateway.process.clock import NS_PER_S

JUDGED_FROM = 5.0
"""m/s: slower, the way between fixes is no longer than the tolerance"""
TOLERANCE_M = 0.3
"""ten standard deviations of the difference of two fixes with 0.02 m each"""
ACROSS = 0.08
"""of the way: side slip of 0.08 rad, the most the tyres hold, that the reckoned heading leaves out"""
ALONG = 0.06
"""of the way: slip of the wheels when driven or braked hard"""
JITTER_S = 0.03
"""a fix that came three periods of the gateway late, or early"""
FORGIVEN = 0.25
"""refused fixes an accepted one makes up for: single outliers are forgotten, every second one is not"""
WRONG = 4.0
"""refused fixes in a row, 0.2 s at 20 Hz"""


class PositionMonitor:
    """`suspect` from the first fix that does not fit on, `wrong` from the fourth until the car stands."""

    def __init__(self) -> None:
        self._level = 0.0
        self._seq = 0
        self._last_ns: int | None = None
        self._reference: tuple[float, float, float] | None = None
        """x, y, yaw carried on from the last fix that agreed; None before it"""
        self._way_m = 0.0
        self.wrong = False

    @property
    def suspect(self) -> bool:
        """Whether fixes, and estimates made with them, are not to be believed now."""
        return self.wrong or self._level > 0.0

    def step(self, now_ns: int, state: VehicleState, motion: Motion, pose: Pose | None) -> None:
        """Judge the fix of this period, if one came; `pose` gives the heading to begin with."""
        dt = 0.0 if self._last_ns is None else min((now_ns - self._last_ns) / NS_PER_S, 0.1)
        self._last_ns = now_ns
        if pose is None or motion.speed < JUDGED_FROM:
            self._reference, self._level = None, 0.0
            self.wrong = self.wrong and motion.speed > 0.0
            self._seq = state.position_seq
            return
        self._carry_on(motion, dt)
        if state.position_seq != self._seq:
            self._seq = state.position_seq
            self._judge(state.position_x, state.position_y, motion, pose)

    def _carry_on(self, motion: Motion, dt: float) -> None:
        if self._reference is None:
            return
        x, y, yaw = self._reference
        middle = yaw + 0.5 * motion.yaw_rate * dt
        way = motion.speed * dt
        self._reference = x + way * math.cos(middle), y + way * math.sin(middle), yaw + motion.yaw_rate * dt
        self._way_m += way

    def _judge(self, x: float, y: float, motion: Motion, pose: Pose) -> None:
        if self._reference is None or self._agrees(x, y, motion.speed):
            self._level = max(self._level - FORGIVEN, 0.0)
            yaw = pose.yaw if self._reference is None or self._level <= 0.0 else self._reference[2]
            self._reference, self._way_m = (x, y, yaw), 0.0
        else:
            self._level = min(self._level + 1.0, WRONG)
        self.wrong = self.wrong or self._level >= WRONG

    def _agrees(self, x: float, y: float, speed: float) -> bool:
        assert self._reference is not None
        x0, y0, yaw = self._reference
        cos, sin = math.cos(yaw), math.sin(yaw)
        along, across = cos * (x - x0) + sin * (y - y0), cos * (y - y0) - sin * (x - x0)
        longest = TOLERANCE_M + ALONG * self._way_m + JITTER_S * speed
        return abs(along) <= longest and abs(across) <= TOLERANCE_M + ACROSS * self._way_m
