"""By which angle the car turns: the one that its steering reports, or the one that it is asked for.

A filter takes each of them for true, and what gyro, accelerometer and wheels show is likeliest for the filter that is
right (multiple-model estimation: D. T. Magill, IEEE Trans. Automatic Control 10, 1965). They know what brakes and slip
leave of a turn. Of commands there are two, which differ by how late the steering answers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from hil_gateway.car.car import Car
from hil_gateway.observer.bank import CHANCE, DOUBTED, FILTERS, GATE, RENEWED_S, FilterLane, Filters
from hil_gateway.observer.lateral import DELAY, ZERO, LateralPeriod, lateral_filters
from hil_gateway.process.arrays import Array

TOLD = 0.5 * DOUBTED
"""of the logarithm of a likelihood: one in a hundred"""
FOUND = -math.log(CHANCE)
"""the same of a fault, when both angles should be one"""

OF_ANGLE = slice(ZERO, DELAY + 1)
"""states that each angle has of its own: its zero, and how late the car turns by it"""


class SteeringHypotheses(Filters):
    """Filters of the car as it turns by its report, by its command, and by an older command."""

    def __init__(self, car: Car) -> None:
        super().__init__(*lateral_filters(car), with_imu=FILTERS)
        self._beyond = [0.0, 0.0, 0.0]
        """of the angles that are taken for true beyond the reported one, rad: part of each filter's steering zero"""
        self._unlikely = [0.0, 0.0, 0.0]
        """negative log-likelihoods of what was shown lately"""
        self._runs, self._age_s = False, 0.0

    def step(self, period: LateralPeriod, asked: Sequence[float], others: Sequence[bool], learnt: FilterLane) -> None:
        """With an IMU. `asked`: commanded angles that the steering has had the time to answer, the newer and the older
        one, rad at the road wheel; `learnt`: a filter of this period, from which these begin."""
        agree = period.steers > 0.0 and abs(self.answer) < TOLD
        if not self._runs or (self._age_s > 2.0 * RENEWED_S and agree):
            self._renew(learnt)
        self._age_s += period.dt
        for i, (lane, angle) in enumerate(zip(self._all, (period.steer, *asked), strict=True)):
            beyond = angle - period.steer
            lane.mean[ZERO] += beyond - self._beyond[i]
            self._beyond[i] = beyond
        self._step(period._replace(steers=1.0), others, True)
        shown = [lane.others[0] + 0.5 * min(lane.fit[0], GATE**2) for lane in self._all]
        explained = min(shown) < TOLD  # else something else is wrong, which tells nothing of angles
        for i, now in enumerate(shown):
            self._unlikely[i] += explained * now - self._unlikely[i] * period.dt / RENEWED_S

    def _renew(self, learnt: FilterLane) -> None:
        """The angles agree: begin anew, but with what each angle has of its own."""
        self._runs, self._age_s = True, 0.0
        for lane in self._all:
            mean, covariance = lane.mean[OF_ANGLE].copy(), lane.covariance[OF_ANGLE, OF_ANGLE].copy()
            lane.renew(learnt)
            self._give(lane, mean, covariance)

    @staticmethod
    def _give(lane: FilterLane, mean: Array, covariance: Array) -> None:
        """What an angle has of its own, independent of all else."""
        lane.mean[OF_ANGLE] = mean
        lane.covariance[OF_ANGLE, :] = lane.covariance[:, OF_ANGLE] = 0.0
        lane.covariance[OF_ANGLE, OF_ANGLE] = covariance

    def forget(self) -> None:
        """The car does not obey, or nothing tells how it turns; what angles seemed to be like while they were doubted
        is not kept."""
        if abs(self.answer) > TOLD:
            self._beyond = [0.0, 0.0, 0.0]
            for lane in self._all:
                self._give(lane, self._prior[0][OF_ANGLE], self._prior[1][OF_ANGLE, OF_ANGLE])
        self._runs = False
        self._unlikely = [0.0, 0.0, 0.0]

    @property
    def answer(self) -> float:
        """How much likelier it is that the car turns as it is asked to than as it reports, as a logarithm; that
        the steering answers late does not make its report likelier."""
        reported, newer, older = self._unlikely
        return max(reported - newer, 0.0) + min(reported - min(newer, older), 0.0)

    @property
    def told(self) -> tuple[FilterLane, float] | None:
        """The filter of the angle that the car is told to turn by, and by how much that is beyond the reported one,
        rad; None where neither is told."""
        if not (self.as_reported or self.as_asked):
            return None
        i = 0 if self.as_reported else min(range(1, FILTERS), key=self._unlikely.__getitem__)
        return self._all[i], self._beyond[i]

    @property
    def off(self) -> float:
        """How unlikely the less likely angle is, as a share of what chance explains."""
        return abs(self.answer) / FOUND

    @property
    def as_reported(self) -> bool:
        """Whether it is told that the car turns as its steering reports."""
        return self.answer < -TOLD

    @property
    def as_asked(self) -> bool:
        """Whether it is told that it turns as it is asked to."""
        return self.answer > TOLD
