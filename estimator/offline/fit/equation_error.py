"""Joint fit of tyre and effect parameters: robust nonlinear least squares with a prior, bounds and honest errors.

The covariance is the sandwich H^-1 M H^-1 with M summed over blocks of time, so that residuals correlated within a
block do not make it too small. Source: Newey & West (1987); MacKinnon & White (1985) for few blocks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.model.columns import CHANNELS, ModelColumns
from estimator.model.parameters import Parameter
from estimator.offline.fit.gauss_newton import minimise
from estimator.offline.fit.problem import AlgebraicProblem, FitProblem, FitSettings
from estimator.offline.record.prepare import Samples
from hil_gateway.process.arrays import Array

COARSE, FINE = 1e-3, 1e-8
"""Relative decreases of the cost at which a round of iterations ends: before the spreads settle, and after."""

SPREAD_ROUNDS = 3
"""How often the spreads are estimated anew, from a start far from the answer."""

STARTING_SAMPLES = 20_000
"""Samples that are enough to come close to the answer."""

BLOCKS_PER_PARAMETER = 10.0
"""Time blocks per parameter at which the sandwich and its average count alike."""

DRAWS = 1000
"""of each sign"""

LEAST_USABLE = 0.5
"""share of draws for which B, C and D exist within their bounds"""

ON_BOUND = 0.1
"""Share of its standard deviation, and of a tenth of its range, within which an estimate counts as on its bound."""

NEARLY_WHITE = 3.0
"""Average inflation of the variance up to which residuals count as nearly white."""


@dataclass(frozen=True)
class EquationErrorFit:
    """Result of a fit.

    Attributes:
        parameters: table the vector is ordered by: tyre, then effects.
        theta: (p,) estimate, SI.
        covariance: (p, p) of the estimate, SI; allows for correlated residuals.
        information: (p, p) Fisher information of the data, in units scaled by the prior standard deviation.
        spread: channel -> robust standard deviation of its residual.
        rmse: channel -> root mean square residual on the data fitted.
        at_bound: names of the parameters that ended on a bound.
        converged: whether the last step was below the tolerance.
    """

    parameters: tuple[Parameter, ...]
    theta: Array
    covariance: Array
    information: Array
    spread: Mapping[str, float]
    rmse: Mapping[str, float]
    at_bound: tuple[str, ...]
    iterations: int
    converged: bool

    @property
    def names(self) -> tuple[str, ...]:
        """Parameter names in the order of `theta`."""
        return tuple(p.name for p in self.parameters)

    @property
    def values(self) -> dict[str, float]:
        """name -> estimate, SI."""
        return dict(zip(self.names, self.theta.tolist(), strict=True))

    @property
    def std(self) -> dict[str, float]:
        """name -> standard deviation, SI."""
        return dict(zip(self.names, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))


def fit(
    columns: ModelColumns, samples: Samples, settings: FitSettings | None = None, start: Array | None = None
) -> EquationErrorFit:
    """Estimate all parameters of `columns.model` from `samples`; `start` (p,) SI instead of the prior.

    A long log is first fitted on every so many of its samples: from there few rounds over all of them are needed.
    """
    settings, start = settings or FitSettings(), columns.start if start is None else start
    problem = AlgebraicProblem(columns, samples, settings)
    if (every := len(samples) // STARTING_SAMPLES) < 2:
        return solve(problem, start)
    few = AlgebraicProblem(columns, samples.select(np.arange(len(samples)) % every == 0), settings)
    return solve(problem, solve(few, start).theta, rounds=2, far=False)


def solve(problem: FitProblem, start: Array, rounds: int = SPREAD_ROUNDS, far: bool = True) -> EquationErrorFit:
    """Minimise the cost of `problem` from `start` (p,) SI, with the spreads estimated anew between `rounds`.

    `far`: the start is far from the answer, and so are its residuals.
    """
    u = np.clip(problem.scaled(start), problem.lower, problem.upper)
    iterations, converged = 0, False
    for number, decrease in enumerate((*[COARSE] * (rounds - 1), FINE)):
        problem.spread = problem.first_spread(u) if far and number == 0 else problem.robust_spread(u)
        u, used, converged = minimise(problem, u, decrease)
        iterations += used
    return _result(problem, u, iterations, converged)


def residuals(columns: ModelColumns, samples: Samples, theta: Array, channels: Sequence[str] = CHANNELS) -> Array:
    """(len(channels), n) measured minus predicted."""
    measured = samples.channels[[CHANNELS.index(c) for c in channels]]
    return np.asarray(measured - columns.predict(samples.inputs, theta, channels), float)


def rmse(columns: ModelColumns, samples: Samples, theta: Array, channels: Sequence[str] = CHANNELS) -> dict[str, float]:
    """channel -> root mean square of measured minus predicted."""
    errors = residuals(columns, samples, theta, channels)
    return {c: float(np.sqrt(np.mean(e**2))) for c, e in zip(channels, errors, strict=True)}


def _covariance(information: Array, scatter: Array, blocks: int, problem: FitProblem, free: NDArray[np.bool_]) -> Array:
    """Covariance (p, p), SI, as if there were no bounds; one that ended on its bound is as uncertain as its prior.

    What was held on its bound is not known there: with it held, the others would look surer than they are.
    With many blocks, or strongly correlated residuals, it is the sandwich, enlarged for the parameters that the blocks
    were fitted with. With few blocks, whose scatter is itself uncertain, and nearly white residuals it tends to the
    inverse information times their average inflation.
    """
    bread = np.linalg.pinv(information + problem.precision, hermitian=True)
    meat = scatter + problem.precision
    inflation = max(1.0, float(np.trace(bread @ meat)) / problem.size)
    few = blocks / max(blocks - problem.size, 1)
    share = blocks / (blocks + BLOCKS_PER_PARAMETER * problem.size) if inflation < NEARLY_WHITE else 1.0
    scaled = share * few * bread @ meat @ bread + (1.0 - share) * inflation * bread
    held = np.flatnonzero(~free)
    scaled[held, held] = np.maximum(scaled[held, held], 1.0)
    return np.asarray(scaled * np.outer(problem.scale, problem.scale))


def _along_the_curve(covariance: Array, problem: FitProblem, u: Array, free: NDArray[np.bool_]) -> Array:
    """`covariance` with the spreads that normally distributed forces at three slips have in B, C and D.

    Where B, C and D are known together but hardly each, the covariance at the estimate is that of a tangent; draws
    are led along the curve instead, and the ratio of what 95 % of them keep within to the tangent's scales it.
    """
    local = problem.coordinates.about(u)
    T = local.tangent()
    to_w = np.linalg.inv(T)
    scaled = covariance / np.outer(problem.scale, problem.scale)
    values, vectors = np.linalg.eigh(scaled * np.outer(free, free))
    half = np.random.default_rng(0).standard_normal((DRAWS, problem.size)) * np.sqrt(np.maximum(values, 0.0))
    tangent = np.concatenate([half, -half]) @ vectors.T
    there = local.moved(tangent @ to_w.T)
    curved = there - u
    usable = ((there >= problem.lower) & (there <= problem.upper))[:, free].all(axis=1)
    if usable.mean() < LEAST_USABLE:
        return covariance
    reached, plain = (np.quantile(np.abs(draws[usable]), 0.95, axis=0) for draws in (curved, tangent))
    ratio = np.where(free, reached / np.maximum(plain, 1e-300), 1.0)
    return np.asarray(covariance * np.outer(ratio, ratio))


def _result(problem: FitProblem, u: Array, iterations: int, converged: bool) -> EquationErrorFit:
    information, scatter, blocks = problem.information_and_scatter(u)
    free = (u > problem.lower) & (u < problem.upper)
    covariance = _covariance(information, scatter, blocks, problem, free)
    covariance = _along_the_curve(covariance, problem, u, free)
    std = np.sqrt(np.diag(covariance)) / problem.scale
    near = ON_BOUND * np.minimum(std, 0.1 * (problem.upper - problem.lower))
    on_bound = ~free | (np.minimum(u - problem.lower, problem.upper - u) < near)
    return EquationErrorFit(
        parameters=problem.table,
        theta=problem.theta(u),
        covariance=covariance,
        information=information,
        spread=dict(zip(problem.channels, problem.spread.tolist(), strict=True)),
        rmse=dict(zip(problem.channels, problem.residual_rms(u).tolist(), strict=True)),
        at_bound=tuple(p.name for p, stuck in zip(problem.table, on_bound, strict=True) if stuck),
        iterations=iterations,
        converged=converged,
    )
