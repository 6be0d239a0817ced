"""A bank of filters: one with all sources, and two in turn that do without the IMU, each begun anew from the first.

A filter that does without a source is begun anew every few seconds: what the source is wrong by has not been in it for
at least `RENEWED_S`. What the source shows beyond what it predicts, over the deviation of that, is chi-square
distributed while nothing is wrong.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import NormalDist

import numpy as np

from hil_gateway.process.arrays import Array
from hil_gateway.process.compiled import CompiledFunction

RENEWED_S = 2.0
"""age of a filter that does without the IMU when the other one is begun anew: bends are entered within less"""
FALSE_ALARMS_PER_HOUR = 1e-3
"""of one test"""
INDEPENDENT_S = 0.5
"""s after which what the model is wrong by is another"""
CHANCE = FALSE_ALARMS_PER_HOUR * INDEPENDENT_S / 3600.0
"""that a test may be wrong with, once"""
GATE = NormalDist().inv_cdf(1.0 - 0.5 * CHANCE)
"""deviations from which a reading is not taken in"""
DOUBTED = -2.0 * math.log(0.01)
"""exceeded once in a hundred: no filter is begun anew, as what has been wrong for a second may be about to be found"""


class FilterLane:
    """One filter."""

    def __init__(self, mean: Array, covariance: Array) -> None:
        self.mean, self.covariance, self.age_s = mean.copy(), covariance.copy(), 0.0
        self.off: list[float] = []
        """what the measurements show beyond what is predicted, in deviations"""
        self.seen, self.spread = np.zeros(0), np.zeros((0, 0))
        """what the IMU is predicted to show, and its covariance"""

    def renew(self, other: FilterLane) -> None:
        """Go on from where another one is."""
        self.mean, self.covariance, self.age_s = other.mean.copy(), other.covariance.copy(), 0.0


class Bank:
    """Filters of one model."""

    def __init__(self, function: CompiledFunction, prior: tuple[Array, Array], fast: int, imu: int) -> None:
        """`prior`: mean and standard deviation of the states, of which the first `fast` are forgotten while the car
        stands; the last `imu` measurements are the IMU's."""
        self._function, self._fast, self._imu = function, fast, imu
        self._prior = prior[0], np.diag(prior[1] ** 2)
        self.main = FilterLane(*self._prior)
        self._lanes = FilterLane(*self._prior), FilterLane(*self._prior)
        self._moving = False

    @property
    def without(self) -> FilterLane:
        """The older one of those without the IMU."""
        return max(self._lanes, key=lambda lane: lane.age_s)

    def step(self, period: Sequence[float], others: Sequence[bool], imu: bool) -> None:
        """A period whose first entry is its length; which other measurements are there, and whether the IMU is."""
        if not self._moving:
            self._begin()
        there = [float(one) for one in others]
        self._advance(self.main, period, [*there, *[float(imu)] * self._imu])
        for lane in self._lanes:
            self._advance(lane, period, [*there, *[0.0] * self._imu])

    def renew(self) -> None:
        """The IMU fits: what does without it may begin anew, when it is its turn."""
        if self.without.age_s > 2.0 * RENEWED_S:
            self.without.renew(self.main)

    def pause(self) -> None:
        """The car is slow, or its inputs are not known."""
        self._moving = False

    def fits(self, shown: Sequence[float], signs: Sequence[float]) -> float:
        """Chi-square of what the IMU shows with other signs, by what does without it."""
        off = np.array(signs) * np.array(shown) - self.without.seen
        return float(off @ np.linalg.solve(self.without.spread, off))

    def _begin(self) -> None:
        """At rest a car does not move; what has been learnt of it stays."""
        fast, (mean, covariance), main = self._fast, self._prior, self.main
        slow = main.covariance[fast:, fast:].copy()
        main.mean[:fast], main.covariance = mean[:fast], np.zeros_like(covariance)
        main.covariance[:fast, :fast], main.covariance[fast:, fast:] = covariance[:fast, :fast], slow
        for lane, age_s in zip(self._lanes, (0.0, RENEWED_S), strict=True):
            lane.renew(main)
            lane.age_s = age_s
        self._moving = True

    def _advance(self, lane: FilterLane, period: Sequence[float], uses: Sequence[float]) -> None:
        mean, covariance, given, used, gate = self._function.inputs
        mean[:, 0], covariance[:], given[:, 0], used[:, 0], gate[0, 0] = (
            lane.mean, lane.covariance, period, uses, GATE,
        )  # fmt: skip
        self._function()
        mean, covariance, off, deviation, seen, spread = self._function.outputs
        lane.mean, lane.covariance = mean[:, 0].copy(), covariance.copy()
        lane.off = (off[:, 0] / deviation[:, 0]).tolist()
        lane.seen, lane.spread = seen[:, 0].copy(), spread.copy()
        lane.age_s += period[0]
