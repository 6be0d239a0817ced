"""Filters of one model side by side, and a bank of them: one with all sources, and two in turn that do without the IMU,
each begun anew from the first.

A filter that does without a source is begun anew every few seconds: what the source is wrong by has not been in it for
at least `RENEWED_S`. What the source shows beyond what it predicts, over the deviation of that, is chi-square
distributed while nothing is wrong.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import NormalDist
from struct import Struct

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
FILTERS = 3
"""of a bank; or three steering angles that may be true"""


class FilterLane:
    """One filter of several: views of its part of the arrays of all."""

    def __init__(self, function: CompiledFunction, i: int) -> None:
        (means, covariances, _, uses), (_, _, off, fit, unlikely) = function.inputs, function.outputs
        n = len(means)
        self.mean, self.covariance, self.uses = means[:, i], covariances[:, n * i : n * (i + 1)], uses[:, i]
        self.now = self.mean.data
        """the mean, of which single numbers are read"""
        self.off = off[:, i].data
        """what the measurements show beyond what is predicted, in deviations"""
        self.fit = fit[:, i].data
        """chi-square of what the IMU shows"""
        self.others = unlikely[:, i].data
        """negative log-likelihood of what all others show that are used"""
        self.age_s = self.gains = 0.0
        """since it was begun; and how much likelier the filter with all sources has made the others since then, as a
        logarithm"""

    def renew(self, other: FilterLane) -> None:
        """Go on from where another one is."""
        self.mean[:], self.covariance[:], self.age_s, self.gains = other.mean, other.covariance, 0.0, 0.0


class Filters:
    """`FILTERS` of one model, that step together."""

    def __init__(
        self, function: CompiledFunction, numbers: Sequence[float], prior: tuple[Array, Array], fast: int, imu: int,
        *, with_imu: int = 1,
    ) -> None:  # fmt: skip
        """`function` of `FILTERS`, of which the first `with_imu` take in the IMU; it is given the `numbers` of the car
        after those of the period; `prior`: mean and standard deviation of the states, of which the first `fast` are
        forgotten while the car stands; the last `imu` measurements are the IMU's."""
        self._function, self._fast, self._imu = function, fast, imu
        self._prior = prior[0], np.diag(prior[1] ** 2)
        self._all = [FilterLane(function, i) for i in range(FILTERS)]
        self.main, *self._lanes = self._all
        self._with_imu = self._all[:with_imu]
        for lane in self._all:
            lane.mean[:], lane.covariance[:] = self._prior
        self._used: tuple[bool, ...] = ()
        """measurements that were there in the last period"""
        given = function.inputs[2][:, 0]
        given[-len(numbers) :] = numbers
        self._given, self._period = given.data, Struct(f"{len(given) - len(numbers)}d")
        self._before, self._after = (
            [array.reshape(-1, order="F").data for array in of[:2]] for of in (function.inputs, function.outputs)
        )
        """means and covariances of all filters: copied through views, several times quicker than arrays"""

    def _step(self, period: Sequence[float], others: Sequence[bool], imu: bool) -> None:
        """A period whose first entry is its length; which other measurements are there, and whether the IMU is."""
        self._period.pack_into(self._given, 0, *period)
        if self._used != (used := (*others, imu)):
            self._used, uses = used, self._function.inputs[3]
            uses[: -self._imu] = np.array(others)[:, np.newaxis]
            for lane in self._with_imu:
                lane.uses[-self._imu :] = imu
        self._function()
        for before, after in zip(self._before, self._after, strict=True):
            before[:] = after


class Bank(Filters):
    """One filter with all sources, and two in turn that do without the IMU, each begun anew from the first."""

    _moving = False

    @property
    def without(self) -> FilterLane:
        """The older one of those without the IMU."""
        first, second = self._lanes
        return first if first.age_s >= second.age_s else second

    def step(self, period: Sequence[float], others: Sequence[bool], imu: bool) -> None:
        """A period whose first entry is its length; which other measurements are there, and whether the IMU is."""
        if not self._moving:
            self._begin()
        self._step(period, others, imu)
        for lane in self._lanes:
            lane.age_s += period[0]
            lane.gains += lane.others[0] - self.main.others[0]

    def renew(self) -> None:
        """The IMU fits: what does without it may begin anew, when it is its turn."""
        if self.without.age_s > 2.0 * RENEWED_S:
            self.without.renew(self.main)

    def pause(self) -> None:
        """The car is slow, or its inputs are not known."""
        self._moving = False

    def _begin(self) -> None:
        """At rest a car does not move; what has been learnt of it stays."""
        fast, (mean, covariance), main = self._fast, self._prior, self.main
        main.mean[:fast], main.covariance[:fast], main.covariance[fast:, :fast] = mean[:fast], covariance[:fast], 0.0
        for lane, age_s in zip(self._lanes, (0.0, RENEWED_S), strict=True):
            lane.renew(main)
            lane.age_s = age_s
        self._moving = True
