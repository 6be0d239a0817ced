"""Position fixes against the way the car has gone by wheels and gyro since the last fix that agreed.

A step, a receiver that repeats its last fix, a delay, noise of a lost correction service and a second sender all put
fixes where the car cannot have gone; a ramp adds up. Where the heading is not known, or says little yet, a fix lies no
further on than the car has gone. A drift below 12 % of the speed does not show, heading and rolling radius explain it:
only other receivers do (`receivers.py`).
"""

from __future__ import annotations

import math

from hil_gateway.bus.latest import Latest
from hil_gateway.bus.messages import Estimate, VehicleState
from hil_gateway.gateway.perceive.course import apart_at_most
from hil_gateway.gateway.perceive.dead_reckoning import Pose
from hil_gateway.gateway.perceive.duration import CONTRADICTED_S, JITTER_S, UNSEEN_S, ConditionTime
from hil_gateway.gateway.perceive.inbox import ESTIMATE_MAX_S
from hil_gateway.gateway.perceive.motion import Motion
from hil_gateway.gateway.perceive.positions.fixes import MOVING
from hil_gateway.gateway.perceive.road_speed import STANDSTILL, rests, road_speed
from hil_gateway.process.clock import NS_PER_S

SLIPS = 0.06
"""of the way: side slip beyond what goes with the lateral force; slip of wheels that are driven or braked hard"""
SHARE = 0.12
"""of the way, or of the speed, that fixes may differ by on average: slides (0.08), unequal rolling radii (0.05)"""
AVERAGED = 0.1
"""weight of a fix in that average: half a second"""
WRONG = 4.0
"""refused fixes in a row, 0.2 s at 20 Hz; so many accepted ones make up for one of them: single outliers are forgotten,
every second one is not"""


class PositionMonitor:
    """`suspect` from the first fix that does not fit on, `wrong` from the fourth until the car stands, and they fit."""

    def __init__(self, noise: float) -> None:
        """`noise` of a fix, m."""
        self._tolerance = apart_at_most(noise)
        self._level = 0.0
        self._seq = 0
        self._last_ns: int | None = None
        self._reference: Pose | None = None
        """that of a point which goes where it points, carried on from the last fix that agreed; None before it"""
        self._way_m = 0.0
        self._place: tuple[float, float] | None = None
        """the last fix that agreed, of a car that is slow or has no heading, since which it has gone so far"""
        self._aside = self._ahead = 0.0
        """mean residual over the way since the fix before"""
        self._fix_ns: int | None = None
        self.wrong = False
        self.source = ""
        """what found it first, in words"""
        self.refused = self._contradicted = False
        """by the estimator, until the car stands; by gyro, wheels and steering now"""
        self._answering, self._estimated = ConditionTime(), False
        self.lost_s = 0.0
        """seconds without a fix while moving"""

    @property
    def suspect(self) -> bool:
        """Whether fixes, and estimates made with them, are not to be believed now."""
        return self.wrong or self.refused or self._contradicted or self._level > 0.0

    def _note(self, found: bool, source: str) -> None:
        self.source = source if found and not (self.wrong or self.refused) else self.source
        self.wrong = self.wrong or found

    def outvoted(self, held_s: float) -> None:
        """Both other receivers have moved away from the fixes for so long."""
        tells = self._reference is not None and held_s > CONTRADICTED_S
        self._note(tells, "both other receivers have moved away from them")

    def contradicted(self, held_s: float) -> None:
        """The course of the fixes has contradicted the gyro, with which the observer sides, for so long."""
        self._contradicted = held_s > 0.0
        self._note(held_s > CONTRADICTED_S, "their course contradicts gyro, wheels and steering")

    def heed(self, now_ns: int, state: VehicleState, estimate: Latest[Estimate], believed: bool) -> None:
        """An estimator that refuses the fixes goes on without them: it still answers, and calls itself invalid.

        `believed`: so are the sensors it judges them by.
        """
        # valid states for twice the age that an estimate may have: an invalid one answers one of them
        answers = believed and state.valid and self._reference is not None and estimate.alive(now_ns)
        settled = self._answering.update(answers, now_ns) > 2.0 * ESTIMATE_MAX_S
        refuses = settled and self._estimated and not estimate.valid(now_ns)
        self.source = "the estimator refuses them" if refuses and not (self.wrong or self.refused) else self.source
        self.refused = self.refused or refuses
        self._estimated = settled and estimate.valid(now_ns)

    def step(self, now_ns: int, state: VehicleState, motion: Motion, pose: Pose | None, *, rolls: bool) -> None:
        """Judge the fix of this period, if one came; `pose` gives the heading to begin with. `rolls`: in no stop,
        under whose brakes wheels lock and do not tell how far a slow car has gone."""
        dt = 0.0 if self._last_ns is None else (now_ns - self._last_ns) / NS_PER_S
        self._last_ns = now_ns
        if dt > UNSEEN_S:  # held up itself
            self._reference = None
        if pose is None or motion.speed < MOVING:
            self._reference, self._aside, self._ahead = None, 0.0, 0.0
            self.lost_s, self._fix_ns = 0.0, now_ns
            self._creep(state, motion.speed, dt, rolls)
            if motion.speed == 0.0 or (rolls and road_speed(state) < STANDSTILL and self._level <= 0.0):
                self.wrong = self.refused = False
            return
        self._place = None
        self._carry_on(motion, dt)
        if state.position_seq != self._seq:
            self._seq, self._fix_ns = state.position_seq, now_ns
            self._judge(state.position_x, state.position_y, motion, pose)
        self.lost_s = (now_ns - (self._fix_ns or now_ns)) / NS_PER_S

    def _creep(self, state: VehicleState, speed: float, dt: float, rolls: bool) -> None:
        """A period of a car that is slow or whose heading is not known; while it stands, all fixes are right."""
        fix, came, self._seq = (state.position_x, state.position_y), state.position_seq != self._seq, state.position_seq
        if rests(state) or not rolls or self._place is None:
            self._place, self._way_m, self._level = fix, 0.0, 0.0
            return
        self._way_m += speed * dt
        if not came:
            return
        agrees = math.dist(fix, self._place) <= self._tolerance + (1.0 + SLIPS) * self._way_m + JITTER_S * speed
        self._count(agrees)
        if agrees or self._level >= WRONG:  # from where they are now they may go on with the car
            self._place, self._way_m = fix, 0.0

    def _carry_on(self, motion: Motion, dt: float) -> None:
        if self._reference is not None:
            way = motion.speed * dt
            self._reference = self._reference.onward(way, motion.yaw_rate * dt)
            self._way_m += way

    def _judge(self, x: float, y: float, motion: Motion, pose: Pose) -> None:
        course, reference = pose.yaw + pose.slip, self._reference
        if reference is None:
            self._reference, self._way_m = Pose(x, y, course, pose.speed), 0.0
            return
        along, across = reference.offset(x, y)
        agrees = self._agrees(along, across, motion.speed)
        self._count(agrees)
        if not agrees:
            return
        most = self._tolerance + SLIPS * self._way_m
        late = along - max(-most, min(along, most))  # not from there: the next fix, in time, would lead too far
        place = reference._replace(x=x, y=y).onward(-late, 0.0)
        self._reference, self._way_m = place._replace(yaw=course) if self._level <= 0.0 else place, 0.0

    def _count(self, agrees: bool) -> None:
        """A fix that agrees with the way the car has gone, or not."""
        self._level = max(self._level - 1.0 / WRONG, 0.0) if agrees else min(self._level + 1.0, WRONG)
        self._note(self._level >= WRONG, "they leave the way by wheels and gyro")

    def _agrees(self, along: float, across: float, speed: float) -> bool:
        longest = self._tolerance + SLIPS * self._way_m + JITTER_S * speed
        if self._way_m > self._tolerance:
            self._aside += AVERAGED * (max(-1.0, min(across / self._way_m, 1.0)) - self._aside)
            self._ahead += AVERAGED * (max(-1.0, min(along / self._way_m, 1.0)) - self._ahead)
        if max(abs(self._aside), abs(self._ahead)) > SHARE:
            return False
        return abs(along) <= longest and abs(across) <= self._tolerance + SLIPS * self._way_m
