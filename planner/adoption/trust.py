"""What may be asked at each place of the lap: all that the belief allows, and less where the car has slid.

The belief is about tyres on all of the lap; a wet stretch or a bump is at one place. Where an axle is seen beyond the
peak of its tyres, speeds before and after that place fall at once and come back lap by lap.
"""

from __future__ import annotations

import math

import numpy as np

from estimator.model.tyre import slip_at_peak
from hil_gateway.bus.messages import Estimate
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.process.arrays import Array
from planner.adoption.usable_grip import Axles
from planner.plan.controller import TyreKnowledge

LOSS = 0.1
"""share of the forces that a slide takes away"""
LEAST = 0.5
"""share that stays after any number of slides: a wet road has no less"""
BACK = 0.03
"""share that comes back every lap"""
BEFORE_M, AFTER_M = 100.0, 200.0
"""how far before a slide speeds fall, where it began, and how far beyond, where the car is going: a few seconds"""
CONFIRMED = 2
"""plans on end, 0.1 s, with an axle beyond the peak: a tip of noise is no slide"""
REPEAT_M = 50.0
"""one slide counts once along so much of the road"""
JUDGED_SPEED = 10.0
"""m/s; slower, slip angles are noise"""


class Trust:
    """Share of the forces along a race line of `length` m, at `points` equal steps."""

    def __init__(self, points: int, length: float) -> None:
        self.share: Array = np.ones(points)
        self._length = length
        self._last, self._lap, self._beyond = -np.inf, 0, 0
        self.slides = 0

    def watch(self, sliding: bool, s: float) -> bool:
        """Take in one plan at progress `s` (m, grows over laps); whether anything has changed."""
        self._beyond = self._beyond + 1 if sliding else 0
        changed = self._come_back(int(s // self._length))
        if self._beyond < CONFIRMED or abs(s - self._last) < REPEAT_M:
            return changed
        self._last = s
        self.slides += 1
        places = np.arange(len(self.share)) * self._length / len(self.share)
        ahead = (places - (s - BEFORE_M)) % self._length
        near = ahead < BEFORE_M + AFTER_M
        self.share = np.where(near, np.maximum((1.0 - LOSS) * self.share, LEAST), self.share)
        return True

    def _come_back(self, lap: int) -> bool:
        if lap <= self._lap:
            return False
        self._lap = lap
        before, self.share = self.share, np.minimum(self.share + BACK, 1.0)
        return bool((before < 1.0).any())


def slides(estimate: Estimate, knowledge: TyreKnowledge, vehicle: Vehicle, axles: Axles) -> bool:
    """Whether an axle is beyond the slip of its tyres' peak, by the estimated motion and the belief's mean."""
    if estimate.vx < JUDGED_SPEED:
        return False
    mean, slips = knowledge.mean.tolist(), slip_angles(estimate, vehicle)
    return any(abs(slip) > slip_at_peak(mean[b], mean[c]) for slip, (b, c, _) in zip(slips, axles, strict=True))


def slip_angles(estimate: Estimate, vehicle: Vehicle) -> tuple[float, float]:
    """Of front and rear axle by the estimated motion, rad; only where the car moves."""
    e = estimate
    return (
        e.steer - math.atan2(e.vy + vehicle.lf * e.yaw_rate, e.vx),
        -math.atan2(e.vy - vehicle.lr * e.yaw_rate, e.vx),
    )
