"""Normal equations of a linearised fit, kept per channel and lap: steps, held-out errors, any subset of parameters."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import ndtri, stdtrit

from estimator.offline.predict.compiled_windows import windows_library
from estimator.offline.record.window_columns import WindowColumns
from hil_gateway.process.arrays import Array, Ints

RIDGE = 1e-10
"""Relative to the diagonal: keeps a direction that the data does not determine from failing the solve."""
TINY = 1e-300
"""Keeps the squares of a channel that is not used, all zero, from being divided."""


@dataclass(frozen=True)
class Normal:
    """Sum of squares around one point of the parameters.

    Attributes:
        squares: (5, laps) sum of squared residuals.
        gradient: (5, laps, p) sensitivity times residual.
        hessian: (5, laps, p, p) sensitivity times sensitivity.
        count: (laps,) residuals a channel.
        prior: (p, p) prior precision; prior_pull: (p,) its pull at this point.
        floor: (5,) variance of the sensor noise.
    """

    squares: Array
    gradient: Array
    hessian: Array
    count: Array
    prior: Array
    prior_pull: Array
    floor: Array

    @cached_property
    def variance(self) -> Array:
        """(5,) of the residuals, at least that of the noise."""
        return np.asarray(np.maximum(self.squares.sum(1) / self.count.sum(), self.floor))

    @cached_property
    def left_out(self) -> Array:
        """(5, laps) squares of each lap predicted by a fit to all the others, channels weighed by their variance."""
        return self.held_out(self.variance)

    def subset(self, rows: Ints) -> Normal:
        """The same with only some of the parameters free."""
        return Normal(
            self.squares, self.gradient[:, :, rows], self.hessian[:, :, rows][..., rows], self.count,
            self.prior[np.ix_(rows, rows)], self.prior_pull[rows], self.floor,
        )  # fmt: skip

    def at(self, rows: Ints, move: Array) -> Normal:
        """The same by its quadratic after parameters `rows` moved by `move`, these held there and all others free."""
        along = self.hessian[..., rows] @ move
        squares = self.squares + along[..., rows] @ move - 2.0 * self.gradient[..., rows] @ move
        pull = self.prior_pull - self.prior[:, rows] @ move
        moved = replace(self, squares=squares, gradient=self.gradient - along, prior_pull=pull)
        return moved.subset(np.delete(np.arange(len(pull)), rows))

    def precision(self, variance: Array) -> Array:
        """(p, p) posterior precision."""
        data: Array = np.einsum("clij,c->ij", self.hessian, 1 / variance, optimize=True)
        return data + self.prior

    def pull(self, variance: Array) -> Array:
        """(p,) right-hand side of the step."""
        data: Array = np.einsum("cli,c->i", self.gradient, 1 / variance)
        return data + self.prior_pull

    def step(self, variance: Array) -> Array:
        """(p,) step to the minimum of the quadratic."""
        return _solve(self.precision(variance), self.pull(variance))

    def estimates_of_parts(self, variance: Array, parts: list[Ints]) -> list[tuple[Array, Array]]:
        """For each list of laps the step (p,) that its data alone would take, and the covariance (p, p) of that."""
        found = []
        for own in parts:
            data = np.einsum("clij,c->ij", self.hessian[:, own], 1 / variance, optimize=True)
            pull = np.einsum("cli,c->i", self.gradient[:, own], 1 / variance)
            precision = data + self.prior
            found.append((_solve(precision, pull + self.prior_pull), inverse(precision)))
        return found

    def steps_without(self) -> Array:
        """(laps, p) step to the minimum of the quadratic without the data of each lap."""
        return self._steps_without(self.variance)

    @cached_property
    def jackknife_variance(self) -> Array:
        """(p,) variance of the parameters by leaving out laps in turn.

        A jackknife (Efron and Tibshirani 1993, ch. 11) is right however residuals are correlated inside a lap.
        Few laps tell a variance badly: it is widened as Student's t is over the normal distribution, so that 1.96
        standard deviations are a 95 % interval.
        """
        steps = self.steps_without()
        laps = len(steps)
        if laps < 2:
            return np.zeros(steps.shape[1])
        variance = np.sum((steps - steps.mean(axis=0)) ** 2, axis=0) * (laps - 1) / laps
        return np.asarray(variance * (stdtrit(laps - 1, 0.975) / ndtri(0.975)) ** 2)

    def _steps_without(self, variance: Array) -> Array:
        own, pulls = np.einsum("clij,c->lij", self.hessian, 1 / variance), self.gradient.T @ (1 / variance)
        return _solve(self.precision(variance) - own, self.pull(variance) - pulls.T)

    def held_out(self, variance: Array) -> Array:
        """(5, laps) squares of each lap predicted by a fit to all the others."""
        steps = self._steps_without(variance)
        along = (self.hessian @ steps[:, :, None])[..., 0] - 2.0 * self.gradient
        return np.asarray(np.maximum(self.squares + (along * steps).sum(axis=2), 0.0))


def inverse(precision: Array) -> Array:
    """Covariance (p, p) of a precision, each parameter in units of its own: forces and slips differ by 1e8."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(precision), TINY))
    scaled = np.linalg.pinv(precision * np.outer(scale, scale), hermitian=True)
    return np.asarray(scaled * np.outer(scale, scale), np.float64)


def _solve(precision: Array, pull: Array) -> Array:
    """(..., p) solutions of one or more systems (..., p, p)."""
    scale = 1.0 / np.sqrt(np.maximum(np.diagonal(precision, axis1=-2, axis2=-1), 1e-300))
    scaled = precision * scale[..., :, None] * scale[..., None, :] + RIDGE * np.eye(pull.shape[-1])
    step: Array = np.linalg.solve(scaled, (pull * scale)[..., None])[..., 0] * scale
    return step


def accumulate(error: Array, sensitivity: WindowColumns, lap: Ints) -> tuple[Array, Array, Array]:
    """Squares, gradient and hessian per channel and lap from the residual (5, w, b) and its sensitivity.

    Every window adds the products of its own columns.
    """
    laps = int(lap.max()) + 1
    squares = np.array([np.bincount(lap, row, laps) for row in (error**2).sum(axis=2)])
    library = windows_library()
    if library is None:
        return squares, *_sums(error, sensitivity, lap, laps)
    blocks, windows, _, count = sensitivity.values.shape
    p = sensitivity.size
    gradient, hessian = np.zeros((5, laps, p)), np.zeros((5, laps, p, p))
    arrays = (error, *map(np.ascontiguousarray, (sensitivity.values, sensitivity.parameters, lap)))
    library.call("accumulate", blocks, windows, count, laps, p, *arrays, gradient, hessian)
    return squares, gradient, hessian


def _sums(error: Array, sensitivity: WindowColumns, lap: Ints, laps: int) -> tuple[Array, Array]:
    p, places = sensitivity.size, sensitivity.parameters
    by_window = sensitivity.values.transpose(1, 2, 0, 3)
    products = by_window.swapaxes(2, 3) @ by_window
    pulls = (by_window.swapaxes(2, 3) @ error.transpose(1, 0, 2)[..., None])[..., 0]
    entry = lap[:, None] * p + places
    pair = (entry[:, :, None] * p + places[:, None]).ravel()
    gradient = [np.bincount(entry.ravel(), pulls[:, c].ravel(), laps * p) for c in range(5)]
    hessian = [np.bincount(pair, products[:, c].ravel(), laps * p * p) for c in range(5)]
    return np.reshape(gradient, (5, laps, p)), np.reshape(hessian, (5, laps, p, p))
