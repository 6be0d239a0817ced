"""Where the car is while nobody estimates it.

An estimate is carried on from its own time on by speed and yaw rate (substitutes of them where a sensor is
gone), and by the side slip that goes with the lateral force; position fixes, which reach the gateway without the
estimator, pull the point back, so that errors cannot add up.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from hil_gateway.bus.messages import Estimate, VehicleState
from hil_gateway.gateway.perceive.course import Course
from hil_gateway.gateway.perceive.duration import UNSEEN_S
from hil_gateway.gateway.perceive.motion import Motion
from hil_gateway.gateway.perceive.road_speed import STANDSTILL
from hil_gateway.observer.observer import SLOWEST
from hil_gateway.process.clock import NS_PER_S

FIX_GAIN = 0.3
"""share of its distance to a fix by which the pose moves: at 20 fixes a second, 1 m/s of drift stay below 0.2 m.
Without a gyro the heading turns by that share of the angle to it: 0.02 m of noise on 1 m are 6 mrad"""


class Pose(NamedTuple):
    """Centre of gravity in the map, m and rad, and speed over ground, m/s."""

    x: float
    y: float
    yaw: float
    speed: float
    slip: float = 0.0
    """rad from where the car points to where it goes; 0 where the yaw is that of a course"""

    def onward(self, way: float, turned: float) -> Pose:
        """After `way` (m), in which it has turned by `turned` (rad): at the end of the chord of that arc."""
        middle = self.yaw + self.slip + 0.5 * turned
        x, y = self.x + way * math.cos(middle), self.y + way * math.sin(middle)
        return Pose(x, y, self.yaw + turned, self.speed, self.slip)

    def offset(self, x: float, y: float) -> tuple[float, float]:
        """How far a point lies ahead of it and to its left, by where it goes, m."""
        dx, dy, cos, sin = x - self.x, y - self.y, math.cos(self.yaw + self.slip), math.sin(self.yaw + self.slip)
        return cos * dx + sin * dy, cos * dy - sin * dx


class DeadReckoning:
    """The pose now; None before the first estimate, and where nothing was heard for so long that it is not known.

    Side slip is carried on as l_r r / v - k a_y (single track with a linear rear tyre), with k of the observer.
    """

    def __init__(self, rear: float) -> None:
        """`rear`: distance of the rear axle behind the centre of gravity, m."""
        self._rear = rear
        self.pose: Pose | None = None
        self._by_gyro = True
        self._pose_ns = 0
        self._answered_ns = 0
        self._fix_seq = 0
        self._blind_m = 0.0

    def step(
        self, now_ns: int, state: VehicleState, motion: Motion, estimate: Estimate | None, believe_fixes: bool = True
    ) -> Pose | None:
        """Pose at `now_ns` from the newest valid estimate, if there is one, and how the car moves.

        `believe_fixes` is false from the first fix on that does not fit the way the car has gone.
        """
        if now_ns - self._pose_ns > UNSEEN_S * NS_PER_S:  # held up itself
            self.pose = None
        if estimate is not None and not (estimate.valid or motion.speed < STANDSTILL):
            estimate = None  # its heading is a guess
        if estimate is not None and (self.pose is None or estimate.state_stamp_ns != self._answered_ns):
            self.pose = Pose(estimate.x, estimate.y, estimate.yaw, estimate.vx, self._slip(motion))
            self._answered_ns = self._pose_ns = estimate.state_stamp_ns
            self._blind_m, self._fix_seq = 0.0, state.position_seq
        if self.pose is not None:
            self.pose = self._carried_on(self.pose, now_ns, motion)
            if believe_fixes:
                self.pose = self._corrected(self.pose, state, motion)
        return self.pose

    def restart(self, now_ns: int, course: Course) -> Pose:
        """Go on from the fixes alone: what has been reckoned so far used a wrong sensor, or nothing has been."""
        self.pose = Pose(course.x, course.y, course.course, course.speed)
        self._pose_ns, self._blind_m, self._by_gyro = now_ns, 0.0, False
        return self.pose

    def _carried_on(self, pose: Pose, now_ns: int, motion: Motion) -> Pose:
        dt = min(max((now_ns - self._pose_ns) / NS_PER_S, 0.0), UNSEEN_S)
        self._pose_ns = now_ns
        way, slip = motion.speed * dt, self._slip(motion)
        self._blind_m += way
        before = pose.yaw if motion.by_gyro == self._by_gyro else pose.yaw + pose.slip - slip
        self._by_gyro = motion.by_gyro  # where the slip is no longer known, the car still goes where it went
        return Pose(pose.x, pose.y, before, motion.speed, slip).onward(way, motion.yaw_rate * dt)

    def _slip(self, motion: Motion) -> float:
        if not motion.by_gyro or motion.speed < SLOWEST:
            return 0.0
        return self._rear * motion.yaw_rate / motion.speed - motion.rear_yields * motion.ay

    def _corrected(self, pose: Pose, state: VehicleState, motion: Motion) -> Pose:
        """Moved towards the fix that arrived this period, if one did."""
        if state.position_seq == self._fix_seq:
            return pose
        self._fix_seq = state.position_seq
        x, y, drifts = state.position_x, state.position_y, not motion.by_gyro
        across = FIX_GAIN * pose.offset(x, y)[1]
        turned = math.atan2(across, self._blind_m) if drifts and pose.speed > SLOWEST else 0.0
        self._blind_m = 0.0
        x, y = pose.x + FIX_GAIN * (x - pose.x), pose.y + FIX_GAIN * (y - pose.y)
        return pose._replace(x=x, y=y, yaw=pose.yaw + turned)
