"""Position fixes against where the car is reckoned to be by wheels and gyro.

A step, a receiver that repeats its last fix, a delay, noise of a lost correction service and a second sender all put
fixes where the car cannot have gone; a ramp adds up. Where the heading is not known, or says little yet, a fix lies no
further on than the car has gone. The fixes of a car that hardly moves are judged by each other: wheels that show a
little while it stands would add up to a way. A drift below 12 % of the speed does not show, heading and rolling radius
explain it: only other receivers do (`receivers.py`).
"""

from __future__ import annotations

import math

from hil_gateway.bus.latest import Latest
from hil_gateway.bus.messages import Estimate, VehicleState
from hil_gateway.gateway.perceive.course import apart_at_most
from hil_gateway.gateway.perceive.dead_reckoning import Reckoned
from hil_gateway.gateway.perceive.duration import CONTRADICTED_S, UNSEEN_S, ConditionTime
from hil_gateway.gateway.perceive.inbox import ESTIMATE_MAX_S
from hil_gateway.gateway.perceive.motion import Motion
from hil_gateway.gateway.perceive.positions.fixes import MOVING
from hil_gateway.gateway.perceive.road_speed import AT_REST, STANDSTILL, road_speed
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.settings.gateway import PERIOD_S

SHARE = 0.12
"""of the way, or of the speed, that fixes may differ by on average: slides (0.08), unequal rolling radii (0.05)"""
WRONG = 4.0
"""refused fixes in a row, 0.2 s at 20 Hz; so many accepted ones make up for one of them: single outliers are forgotten,
every second one is not. An accepted one counts by its squared distance, so that scatter adds up"""


class PositionMonitor:
    """`suspect` from the first fix that does not fit on, `wrong` from the fourth until the car stands, and they fit."""

    def __init__(self, noise: float) -> None:
        """`noise` of a fix, m."""
        self._tolerance, self._apart = apart_at_most(noise), apart_at_most(math.sqrt(2.0) * noise)
        self._at, self._way = 0j, math.inf
        """newest fix that is not refused in a car that hardly moves, and its way since then, m"""
        self._level = 0.0
        self._seq = 0
        self._moves = False
        """whether the car is faster than walking, and it is known where"""
        self._fix_ns: int | None = None
        self._mean = 0j
        """mean distance of a fix from where it is expected, ahead + i to the left, over the way since the one before,
        in the last `UNSEEN_S`"""
        self.fits = True
        """whether the newest fix is where it may be"""
        self.wrong = False
        self.source = ""
        """what found it first, in words"""
        self._answering, self._estimated = ConditionTime(), False
        self.lost_s = 0.0
        """seconds without a fix while moving"""

    @property
    def suspect(self) -> bool:
        """Whether fixes, and estimates made with them, are not to be believed now."""
        return self.wrong or self._level >= 1.0

    def _note(self, found: bool, source: str) -> None:
        self.source = source if found and not self.wrong else self.source
        self.wrong = self.wrong or found

    def outvoted(self, held_s: float) -> None:
        """Both other receivers have moved away from the fixes for so long."""
        tells = self._moves and held_s > CONTRADICTED_S
        self._note(tells, "both other receivers have moved away from them")

    def heed(self, now_ns: int, state: VehicleState, estimate: Latest[Estimate], believed: bool) -> None:
        """An estimator that refuses the fixes goes on without them: it still answers, and calls itself invalid.

        `believed`: so are the sensors it judges them by.
        """
        # valid states for twice the age that an estimate may have: an invalid one answers one of them
        answers = believed and state.valid and self._moves and estimate.alive(now_ns)
        settled = self._answering.update(answers, now_ns) > 2.0 * ESTIMATE_MAX_S
        self._note(settled and self._estimated and not estimate.valid(now_ns), "the estimator refuses them")
        self._estimated = settled and estimate.valid(now_ns)

    def step(self, now_ns: int, state: VehicleState, motion: Motion, reckoned: Reckoned | None, *, rolls: bool) -> None:
        """Judge the fix of this period, if one came, by what is `reckoned` without it. `rolls`: in no stop, under whose
        brakes wheels lock and do not tell how far a slow car has gone."""
        self._moves = reckoned is not None and motion.speed >= MOVING
        came, self._seq = state.position_seq != self._seq, state.position_seq
        stands = road_speed(state) < STANDSTILL
        self._way += PERIOD_S * motion.speed
        if reckoned is None or stands or not (rolls or self._moves):
            self.lost_s, self._fix_ns, self._mean = 0.0, now_ns, 0j
            self._creep(came, state, motion.speed, rolls and stands and reckoned is not None)
            if motion.speed < AT_REST or (rolls and stands and self._level < 1.0):
                self.wrong = False
            return
        if came:
            since_s = max(state.fix_ns - (self._fix_ns or state.fix_ns), 0) / NS_PER_S
            self._fix_ns = state.fix_ns
            self._count(self._off(state, reckoned, since_s))
            self._at, self._way = complex(state.position_x, state.position_y), 0.0
        self.lost_s = (now_ns - (self._fix_ns or now_ns)) / NS_PER_S

    def _creep(self, came: bool, state: VehicleState, speed: float, judges: bool) -> None:
        """A car that hardly moves, if at all."""
        fix, judges = complex(state.position_x, state.position_y), judges and speed >= AT_REST
        self._level = self._level if judges else 0.0
        if came and judges:
            self._count(abs(fix - self._at) / (self._apart + self._way))
        if came and (self.fits or self.wrong or not judges):
            self._at, self._way = fix, 0.0

    def _count(self, off: float) -> None:
        """A fix that is so far off, over what it may be."""
        self.fits = off <= 1.0
        self._level = min(max(self._level + (1.0 if off > 1.0 else off**2 - 1.0 / WRONG), 0.0), WRONG)
        self._note(self._level >= WRONG, "they leave the way by wheels and gyro")

    def _off(self, state: VehicleState, reckoned: Reckoned, since_s: float) -> float:
        """Of a fix, over what it may be, when it came; the one before came so long earlier."""
        ago_s, most = (reckoned.stamp_ns - state.fix_ns) / NS_PER_S, self._tolerance + reckoned.within_m
        along, across = reckoned.pose.offset(state.position_x, state.position_y, ago_s)
        share = complex(along, across) / max(since_s * reckoned.pose.speed, self._tolerance)
        self._mean += min(since_s / UNSEEN_S, 1.0) * (share / max(abs(share), 1.0) - self._mean)
        if abs(self._mean) > max(SHARE, reckoned.slips):
            return math.inf
        return max(abs(along) / (most + PERIOD_S * reckoned.pose.speed), abs(across) / most)
