"""Brakes as the steering that is left: what a car does whose steering stands still.

While its wheels roll, it goes on along its arc. Tyres that slide push against the motion, whichever way they point:
with locked wheels the car goes straight on. Ways that roll on for a while and then slide are reckoned to where the car
stands, and the wheels are locked when to do so now keeps furthest inside of the road. A sliding car cannot be told from
its wheels any more: it slides until it stands.
"""

from __future__ import annotations

import math
from functools import partial

from hil_gateway.car.car import Car
from hil_gateway.gateway.act.stop_path import CLEAR
from hil_gateway.gateway.perceive.dead_reckoning import Pose
from hil_gateway.gateway.perceive.monitors.road import BEYOND, NEAR
from hil_gateway.gateway.perceive.motion import Motion
from hil_gateway.observer.steering import SteeringHypotheses
from hil_gateway.settings.gateway import StopConfig, beside
from hil_gateway.track.track import Track

STEP_S = 0.1
SLIDES_AFTER_S = (0.0, 0.2, 0.4, 0.8, 1.6, math.inf)
"""s of rolling before the slide: the ways that are compared"""


class StuckSteering:
    """Whether to lock the wheels, once a period; `start` with a stop."""

    def __init__(self, car: Car, config: StopConfig, track: Track | None) -> None:
        self._vehicle, self._track = car.vehicle, track
        self._grip = partial(config.grip, car.vehicle)
        self._sliding = math.sin(0.5 * math.pi * car.tyres.c)
        """of the grip that tyres have when they slide: where their curve sin(c atan(b s)) ends"""
        self.stands = False
        """whether the car turns by the angle that is reported, which does not move as it is asked to: steering that is
        reversed or slow does move"""
        self.start()

    def start(self) -> None:
        """A stop begins."""
        self._locks = self.stands = False

    def judge(self, turns: SteeringHypotheses, *, still: bool) -> None:
        """Once a period of a stop; whether the report stands `still`: one that hangs is contradicted by a car that
        `turns` as it is asked to."""
        self.stands = not turns.as_asked and (self.stands or (still and turns.as_reported))

    def locks(self, motion: Motion, pose: Pose | None, steer: float) -> bool:
        """Whether to slide straight on, with all that the brakes give; after `judge`. `steer` is reported, rad."""
        if pose is not None and self._track is not None and self.stands and not self._locks:
            margins = [self._margin(self._track, pose, steer, motion.understeer, t) for t in SLIDES_AFTER_S]
            best = max(margins) == margins[0]
            self._locks = best and margins[-1] < CLEAR and margins[0] > margins[-1] + BEYOND
        return self._locks

    def _margin(self, track: Track, pose: Pose, steer: float, understeer: float, slides_after_s: float) -> float:
        """Least distance of a wheel to the edge until the car stands, m, negative off the road: rolling on along an arc
        that becomes tighter as understeer goes with the speed, then sliding straight on."""
        s, lateral = track.project(pose.x, pose.y)
        least, since_s, speed, turned = math.inf, 0.0, pose.speed, math.tan(steer)
        while speed > 0.0 and least > -NEAR:
            least = min(least, track.inside(s, lateral) - self._vehicle.half_width)
            rolls, grip = since_s < slides_after_s, self._grip(speed)
            turns = turned * self._vehicle.turns(speed, understeer) if rolls else 0.0
            pose = pose.onward(STEP_S * speed, STEP_S * turns)
            speed -= STEP_S * (beside(turns * speed, grip) if rolls else self._sliding * grip)
            s, lateral = track.project(pose.x, pose.y, s)
            since_s += STEP_S
        return least
