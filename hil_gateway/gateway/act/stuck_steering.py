"""Brakes as the steering that is left: what a car does whose steering stands still.

While its wheels roll, it goes on along its arc. Tyres that slide push against the motion, whichever way they point:
with locked wheels the car goes straight on. Ways that roll on for a while and then slide are reckoned to where the car
stands, and the wheels are locked when to do so now keeps furthest inside of the road. A sliding car cannot be told from
its wheels any more: it slides until it stands.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from hil_gateway.car.car import Car
from hil_gateway.gateway.act.stopping import BEYOND_GRIP
from hil_gateway.gateway.perceive.dead_reckoning import Pose
from hil_gateway.gateway.perceive.monitors.actuators import MOVED_SHARE, moved_share
from hil_gateway.gateway.perceive.motion import Motion, periods_late
from hil_gateway.process.arrays import Array
from hil_gateway.settings.gateway import PERIOD_S, StopConfig, beside
from hil_gateway.track.track import Track

STEP_S = 0.1
SLIDES_AFTER_S = (0.0, 0.2, 0.4, 0.8, 1.6, math.inf)
"""s of rolling before the slide: the ways that are compared"""
SLIDING = 0.8
"""of the grip that tyres have when they slide on dry asphalt"""
BETTER_M = 0.5
"""that sliding must keep further inside than rolling on: error of both reckonings"""
CLEAR_M = 1.0
"""inside of the edge, with which rolling on is good enough"""
LOST_M = -10.0
"""how far off the road does not matter any more"""
JUDGED_S = 0.1
"""time constant of the comparison of yaw rates: as long as a car takes to answer its steering"""
WATCHED = 40
"""periods (0.4 s) in which a report must have moved as the command has"""
ASKED = 0.0015
"""rad at the road wheel (1.3 deg at the motor), root mean square, of a command that moves beyond play and noise"""
APART = 0.03
"""rad/s by which one of the angles must explain the yaw rate better than the other: ten times the gyro's noise"""


@dataclass(frozen=True, slots=True)
class _Way:
    """Curvature (1/m) and deceleration (m/s2) at a speed."""

    curvature: Callable[[float], float]
    deceleration: Callable[[float], float]


class StuckSteering:
    """Whether to lock the wheels, once a period; `start` with a stop."""

    def __init__(self, car: Car, config: StopConfig, track: Track | None) -> None:
        self._vehicle, self._track = car.vehicle, track
        self._late, self._turns_in_s = periods_late(car), car.turns_in_s
        self._grip = partial(config.grip, car.vehicle)
        self._angles: deque[tuple[float, float]] = deque(maxlen=WATCHED)
        """reported and asked, rad"""
        self._reported = self._asked = 0.0
        """that the car has had the time to turn with, rad"""
        self._reported_off = self._asked_off = 0.0
        """of the yaw rate from what the reported and the commanded angle come to, lately, rad/s"""
        self.stands = False
        """whether the car turns by the angle that is reported, which does not move as it is asked to: steering that is
        reversed or slow does move"""
        self.start()

    def start(self) -> None:
        """A stop begins."""
        self._locks = self._moves = self.stands = False

    def watch(self, reported: float, asked: float, motion: Motion) -> None:
        """Road-wheel angles of a period, rad; in every period, so that a stop begins with what is known."""
        self._angles.append((reported, asked))
        due = self._angles[max(len(self._angles) - self._late, 0)][1]
        share = PERIOD_S / (PERIOD_S + self._turns_in_s * motion.speed)
        self._reported += share * (reported - self._reported)
        self._asked += share * (due - self._asked)
        self._compare(motion)

    def steers(self, motion: Motion) -> bool:
        """Whether the steering works after all, and only its report is wrong; once a period of a stop.

        A report that moves as the command does comes from steering that moves, whatever its offset; and one that hangs
        is contradicted by a car that turns as it is asked to.
        """
        reported, asked = np.array(self._angles).T
        self._moves = _follows(reported[self._late :], asked[: -self._late], ASKED, self._moves)
        answers = self._moves or (motion.by_gyro and self._asked_off + APART < self._reported_off)
        still = bool(reported.std() < MOVED_SHARE * asked.std())
        turns_as_reported = motion.by_gyro and self._reported_off + APART < self._asked_off
        self.stands = not answers and (self.stands or (still and turns_as_reported))
        return not self._locks and answers

    def deceleration(self, motion: Motion, pose: Pose | None) -> float | None:
        """What to ask of the brakes to slide straight on, m/s2; None where rolling on is better; after `steers`."""
        if pose is not None and self._track is not None and self.stands and not self._locks:
            slides, rolls = self._ways(motion, self._angles[-1][0])
            margins = [self._margin(self._track, pose, rolls, slides, after_s) for after_s in SLIDES_AFTER_S]
            best = max(margins) == margins[0]
            self._locks = best and margins[-1] < CLEAR_M and margins[0] > margins[-1] + BETTER_M
        return BEYOND_GRIP * self._grip(motion.speed) if self._locks else None

    def _compare(self, motion: Motion) -> None:
        """The car's yaw rate with what the reported and the commanded angle come to by now: a stop begins with a
        command that jumps, and a car that obeys it is not stuck because it has not turned yet.

        An angle comes to r = v (tan(delta) - K a_y) / L, and by a change of it the yaw rate changes by v / (L + K v^2);
        the force that is felt tells the understeer K on a bank, too.
        """
        share, length, speed = PERIOD_S / (JUDGED_S + PERIOD_S), self._vehicle.wheelbase, max(motion.speed, 1.0)
        reported, asked = math.tan(self._reported), math.tan(self._asked)
        gain = motion.speed / (length + motion.understeer * motion.speed**2)
        shown = length * motion.yaw_rate / speed + motion.understeer * motion.ay
        self._reported_off += share * (gain * abs(shown - reported) - self._reported_off)
        self._asked_off += share * (gain * abs(shown - asked) - self._asked_off)

    def _ways(self, motion: Motion, steer: float) -> tuple[_Way, _Way]:
        """Sliding straight on, and rolling on along an arc that becomes tighter as understeer goes with the speed."""

        def arc(speed: float) -> float:
            return math.tan(steer) / (self._vehicle.wheelbase + motion.understeer * speed**2)

        def left(speed: float) -> float:
            return beside(arc(speed) * speed**2, self._grip(speed))

        return _Way(lambda speed: 0.0, lambda speed: SLIDING * self._grip(speed)), _Way(arc, left)

    def _margin(self, track: Track, pose: Pose, rolls: _Way, slides: _Way, slides_after_s: float) -> float:
        """Least distance of a wheel to the edge until the car stands, m, negative off the road."""
        x, y, course, speed = pose.x, pose.y, pose.yaw + pose.slip, pose.speed
        s, lateral = track.project(x, y)
        least, since_s = math.inf, 0.0
        while speed > 0.0 and least > LOST_M:
            least = min(least, track.inside(s, lateral) - self._vehicle.half_width)
            way = rolls if since_s < slides_after_s else slides
            since_s += STEP_S
            course += STEP_S * speed * way.curvature(speed)
            x, y = x + STEP_S * speed * math.cos(course), y + STEP_S * speed * math.sin(course)
            speed -= STEP_S * way.deceleration(speed)
            s, lateral = track.project(x, y, s)
        return least


def _follows(done: Array, asked: Array, least: float, before: bool) -> bool:
    """Whether the changes of `done` are at least `MOVED_SHARE` of those of `asked`, arrays (n,); as `before` where
    these are less than `least`, root mean square."""
    if not asked.size or asked.std() <= least:
        return before
    return moved_share(done, asked) > MOVED_SHARE
