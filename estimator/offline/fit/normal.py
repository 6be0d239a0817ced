"""Normal equations of a linearised fit, kept per channel and lap: steps, held-out errors, any subset of parameters."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

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

    def subset(self, rows: Ints) -> Normal:
        """The same with only some of the parameters free."""
        return Normal(
            self.squares, self.gradient[:, :, rows], self.hessian[:, :, rows][..., rows], self.count,
            self.prior[np.ix_(rows, rows)], self.prior_pull[rows], self.floor,
        )  # fmt: skip

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
            found.append((_solve(precision, pull + self.prior_pull), np.linalg.pinv(precision, hermitian=True)))
        return found

    def squares_after(self, step: Array, lap: int | None = None) -> Array:
        """(5, laps) or (5,) squares after `step`, by the quadratic."""
        which = slice(None) if lap is None else slice(lap, lap + 1)
        change = -2 * self.gradient[:, which] @ step + np.einsum(
            "i,clij,j->cl", step, self.hessian[:, which], step, optimize=True
        )
        out: Array = np.maximum(self.squares[:, which] + change, 0.0)
        return out if lap is None else out[:, 0]

    def held_out(self, variance: Array) -> Array:
        """(5, laps) squares of each lap predicted by a fit to all the others."""
        total, pull = self.precision(variance), self.pull(variance)
        out = np.empty_like(self.squares)
        for lap in range(self.squares.shape[1]):
            own = np.einsum("cij,c->ij", self.hessian[:, lap], 1 / variance)
            own_pull = np.einsum("ci,c->i", self.gradient[:, lap], 1 / variance)
            out[:, lap] = self.squares_after(_solve(total - own, pull - own_pull), lap)
        return out


def _solve(precision: Array, pull: Array) -> Array:
    scale = 1.0 / np.sqrt(np.maximum(np.diag(precision), 1e-300))
    scaled = precision * scale[:, None] * scale + RIDGE * np.eye(len(pull))
    step: Array = np.linalg.solve(scaled, pull * scale) * scale
    return step


def accumulate(error: Array, jacobian: Array, lap: Ints) -> tuple[Array, Array, Array]:
    """Squares, gradient and hessian per channel and lap from residual (5, w, b) and sensitivity (5, p, w, b).

    The predictor leaves the parameters of one block side by side in memory: rows of a product are taken in that order.
    """
    laps, p = int(lap.max()) + 1, jacobian.shape[1]
    by_block, residual = jacobian.transpose(0, 3, 2, 1), error.transpose(0, 2, 1)
    squares, gradient, hessian = np.zeros((5, laps)), np.zeros((5, laps, p)), np.zeros((5, laps, p, p))
    for number in range(laps):
        own = lap == number
        for c in range(5):
            j, e = by_block[c][:, own].reshape(-1, p), residual[c][:, own].ravel()
            squares[c, number] = e @ e
            gradient[c, number] = e @ j
            hessian[c, number] = j.T @ j
    return squares, gradient, hessian
