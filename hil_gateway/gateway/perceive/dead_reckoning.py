"""Where the car is while nobody estimates it.

An estimate is carried on from its own time on by speed and yaw rate (substitutes of them where a sensor is
gone), and by the side slip that goes with the lateral force; position fixes, which reach the gateway without the
estimator, pull the point back, so that errors cannot add up, each by as much as it is better than what is reckoned:
that is off by a share of the way since the last one.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from hil_gateway.bus.messages import Estimate, VehicleState
from hil_gateway.gateway.perceive.course import Course, apart_at_most
from hil_gateway.gateway.perceive.duration import UNSEEN_S
from hil_gateway.gateway.perceive.motion import Motion
from hil_gateway.gateway.perceive.road_speed import STANDSTILL
from hil_gateway.observer.observer import SLOWEST
from hil_gateway.process.clock import NS_PER_S

SLIPS = 0.06
"""of the way: side slip beyond what goes with the lateral force; slip of wheels that are driven or braked hard"""
GUESSED = 4.0
"""the same where the heading is a guess: a car that goes the other way is two ways off, and fixes half as far off as
they may be count neither for it nor against it"""


class Pose(NamedTuple):
    """Centre of gravity in the map, m and rad, and speed over ground, m/s."""

    x: float
    y: float
    yaw: float
    speed: float
    slip: float = 0.0
    """rad from where the car points to where it goes; 0 where the yaw is that of a course"""

    @property
    def course(self) -> float:
        """Where it goes, rad."""
        return self.yaw + self.slip

    def onward(self, way: float, turned: float) -> Pose:
        """After `way` (m), in which it has turned by `turned` (rad): at the end of the chord of that arc."""
        middle = self.course + 0.5 * turned
        x, y = self.x + way * math.cos(middle), self.y + way * math.sin(middle)
        return Pose(x, y, self.yaw + turned, self.speed, self.slip)

    def offset(self, x: float, y: float, ago_s: float = 0.0) -> tuple[float, float]:
        """How far a point where the car was so long ago lay ahead of it and to its left, by where it goes, m."""
        dx, dy, cos, sin = x - self.x, y - self.y, math.cos(self.course), math.sin(self.course)
        return cos * dx + sin * dy + self.speed * ago_s, cos * dy - sin * dx


class Reckoned(NamedTuple):
    """A pose and how far it may be off."""

    pose: Pose
    stamp_ns: int
    by_gyro: bool
    off_m: float = 0.0
    """at the last fix that moved it"""
    way_m: float = 0.0
    """since then"""
    slips: float = SLIPS
    """share of that way by which it may be off"""

    @property
    def within_m(self) -> float:
        """What it is off by at most, beside what a fix is."""
        return self.off_m + self.slips * self.way_m


class DeadReckoning:
    """The pose now; None before the first estimate, and where nothing was heard for so long that it is not known.

    Side slip is the observer's.
    """

    def __init__(self, noise: float) -> None:
        """`noise` of a fix, m."""
        self._apart = apart_at_most(noise)
        self.now: Reckoned | None = None
        self._answered_ns = self._fix_seq = 0

    @property
    def pose(self) -> Pose | None:
        """As it was carried on last."""
        return None if self.now is None else self.now.pose

    def step(
        self, now_ns: int, state: VehicleState, motion: Motion, estimate: Estimate | None, believe_fixes: bool = True
    ) -> Pose | None:
        """Pose at `now_ns` from the newest valid estimate, if there is one, and how the car moves.

        `believe_fixes` is false where the newest one does not fit the way the car has gone.
        """
        self.carry_on(now_ns, motion)
        if estimate is not None and not (estimate.valid or motion.speed < STANDSTILL):
            estimate = None  # its heading is a guess
        if estimate is not None and (self.now is None or estimate.state_stamp_ns != self._answered_ns):
            self._answered_ns, self._fix_seq = estimate.state_stamp_ns, state.position_seq
            pose = Pose(estimate.x, estimate.y, estimate.yaw, estimate.vx, motion.slip)
            slips = SLIPS if estimate.valid else GUESSED
            told = Reckoned(pose, self._answered_ns, motion.by_gyro, slips=slips)
            self.now = self._onward(told, now_ns, motion)
        if self.now is not None and believe_fixes and state.position_seq != self._fix_seq:
            self.now = self._corrected(self.now, state)
        self._fix_seq = state.position_seq
        return self.pose

    def carry_on(self, now_ns: int, motion: Motion) -> Reckoned | None:
        """To `now_ns`; where more time has passed than is reckoned over, nothing is known."""
        if self.now is not None:
            held_up = now_ns - self.now.stamp_ns > UNSEEN_S * NS_PER_S
            self.now = None if held_up else self._onward(self.now, now_ns, motion)
        return self.now

    def restart(self, now_ns: int, course: Course) -> Pose:
        """Go on from the fixes alone: what has been reckoned so far used a wrong sensor, or nothing has been."""
        pose = Pose(course.x, course.y, course.course, course.speed)
        self.now = Reckoned(pose, now_ns, by_gyro=False)
        return pose

    def _onward(self, before: Reckoned, now_ns: int, motion: Motion) -> Reckoned:
        dt = min(max((now_ns - before.stamp_ns) / NS_PER_S, 0.0), UNSEEN_S)
        pose, way, slip = before.pose, motion.speed * dt, motion.slip
        # where the slip is no longer known, the car still goes where it went
        yaw = pose.yaw if motion.by_gyro == before.by_gyro else pose.yaw + pose.slip - slip
        pose = Pose(pose.x, pose.y, yaw, motion.speed, slip).onward(way, motion.yaw_rate * dt)
        return Reckoned(pose, now_ns, motion.by_gyro, before.off_m, before.way_m + way, before.slips)

    def _corrected(self, now: Reckoned, state: VehicleState) -> Reckoned:
        """Moved towards a fix (a Kalman filter's step of a point); without a gyro, whose substitutes drift, turned."""
        pose, variance = now.pose, now.off_m**2 + (now.slips * now.way_m) ** 2
        gain = variance / (variance + self._apart**2)
        along, across = pose.offset(state.position_x, state.position_y, (now.stamp_ns - state.fix_ns) / NS_PER_S)
        drifts = not now.by_gyro and pose.speed > SLOWEST
        turned = math.atan2(gain * across, now.way_m) if drifts else 0.0
        cos, sin = gain * math.cos(pose.course), gain * math.sin(pose.course)
        x, y = pose.x + cos * along - sin * across, pose.y + sin * along + cos * across
        off_m = math.sqrt(gain) * self._apart
        return now._replace(pose=pose._replace(x=x, y=y, yaw=pose.yaw + turned), off_m=off_m, way_m=0.0)
