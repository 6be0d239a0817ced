"""Joint fit of tyre and effect parameters: robust nonlinear least squares with a prior, bounds and honest errors.

Parameters are scaled by their prior standard deviation. The loss is Huber's on residuals over the robust spread of
each channel; the step is Gauss-Newton with Levenberg's damping inside the bounds. The covariance is the sandwich
H^-1 M H^-1 with M summed over blocks of time, so that residuals correlated within a block do not make it too small.
Sources: Nocedal & Wright, Numerical Optimization, ch. 10 and 16; Huber, Robust Statistics; Newey & West (1987).
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.identify.coordinates import StepCoordinates
from estimator.identify.evaluate import CHANNELS, ModelColumns
from estimator.identify.prepare import Samples
from estimator.model.parameters import Parameter

Array = NDArray[np.float64]

LATERAL_AND_LONGITUDINAL = ("ax", "ay", "yaw_acc")
"""Channels that determine the tyre parameters; the motion channels add what gravity does."""

COARSE, FINE = 1e-3, 1e-8
"""Relative decreases of the cost at which a round of iterations ends: before the spreads settle, and after."""

MOST_DAMPING = 1e9
"""Damping at which a step is as good as none: the iterations end."""

LONGEST_STEP = 2.0
"""Prior standard deviations a parameter moves at most in one step: farther, the linearisation says nothing."""

BLOCKS_PER_PARAMETER = 10.0
"""Time blocks per parameter at which the sandwich and its average count alike."""

NEARLY_WHITE = 3.0
"""Average inflation of the variance up to which residuals count as nearly white."""


@dataclass(frozen=True)
class FitSettings:
    """How a fit is done.

    `huber`: residuals beyond so many robust spreads count linearly. `block_s`: residuals further apart are taken
    as independent. `prior`: whether the prior takes part. `prior_precision`: (p, p) in units scaled by
    `Parameter.prior_std`, instead of the identity. `spread_rounds`: how often the spreads are estimated anew.
    `tolerance`: a fit has converged when the next step is shorter than so many standard deviations.
    """

    channels: tuple[str, ...] = LATERAL_AND_LONGITUDINAL
    huber: float = 3.0
    block_s: float = 4.0
    prior: bool = True
    prior_precision: Array | None = None
    spread_rounds: int = 3
    max_iterations: int = 40
    tolerance: float = 0.01


@dataclass(frozen=True)
class Fit:
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
) -> Fit:
    """Estimate all parameters of `columns.model` from `samples`; `start` (p,) SI instead of the prior."""
    return solve(
        AlgebraicProblem(columns, samples, settings or FitSettings()), columns.start if start is None else start
    )


def solve(problem: Problem, start: Array) -> Fit:
    """Minimise the cost of `problem` from `start` (p,) SI, with the spreads estimated anew between rounds."""
    u = np.clip(problem.scaled(start), problem.lower, problem.upper)
    iterations, converged = 0, False
    for decrease in (*[COARSE] * (problem.settings.spread_rounds - 1), FINE):
        problem.spread = problem.robust_spread(u)
        u, used, converged = _gauss_newton(problem, u, decrease)
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


class Problem(ABC):
    """One fit in scaled parameters u = (theta - prior) / prior_std; `spread` (c,) weighs the channels."""

    def __init__(self, table: Sequence[Parameter], settings: FitSettings) -> None:
        """Scale, bounds and prior of `table`."""
        self.table, self.settings, self.size = tuple(table), settings, len(table)
        self.prior = np.array([p.prior for p in table])
        self.scale = np.array([p.prior_std for p in table])
        self.lower = self.scaled(np.array([p.lower for p in table]))
        self.upper = self.scaled(np.array([p.upper for p in table]))
        self.precision = self._prior_precision()
        self.spread = np.ones(len(self.channels))

    @property
    @abstractmethod
    def channels(self) -> tuple[str, ...]:
        """Names of the residual channels."""

    @abstractmethod
    def residual_rms(self, u: Array) -> Array:
        """(c,) root mean square residual."""

    @abstractmethod
    def robust_spread(self, u: Array) -> Array:
        """(c,) robust standard deviation of the residuals."""

    @abstractmethod
    def cost(self, u: Array) -> float:
        """Robust loss plus the prior's."""

    @abstractmethod
    def normal_equations(self, u: Array) -> tuple[Array, Array]:
        """Gauss-Newton Hessian (p, p) and gradient (p,) of the cost, prior included."""

    @abstractmethod
    def information_and_scatter(self, u: Array) -> tuple[Array, Array, int]:
        """Data information (p, p), outer products of the scores of time blocks (p, p) summed, number of blocks."""

    def _prior_precision(self) -> Array:
        if not self.settings.prior:
            return np.zeros((self.size, self.size))
        given = self.settings.prior_precision
        return np.eye(self.size) if given is None else np.asarray(given, float)

    def scaled(self, theta: Array) -> Array:
        return np.asarray((theta - self.prior) / self.scale, float)

    def theta(self, u: Array) -> Array:
        return np.asarray(self.prior + self.scale * u)

    def prior_cost(self, u: Array) -> float:
        """Half the squared distance to the prior mean."""
        return 0.5 * float(u @ self.precision @ u)


class AlgebraicProblem(Problem):
    """Forces from measured states against specific forces and yaw acceleration: the paper's formulation."""

    def __init__(self, columns: ModelColumns, samples: Samples, settings: FitSettings) -> None:
        """`settings.channels` of `samples` against `columns`."""
        super().__init__(columns.parameters, settings)
        self.columns, self.samples = columns, samples
        index = [CHANNELS.index(c) for c in settings.channels]
        self.measured = samples.channels[index]
        self.noise = samples.noise[index]

    @property
    def channels(self) -> tuple[str, ...]:
        return self.settings.channels

    def residuals(self, u: Array) -> Array:
        predicted = self.columns.predict(self.samples.inputs, self.theta(u), self.settings.channels)
        return np.asarray(self.measured - predicted)

    def robust_spread(self, u: Array) -> Array:
        errors = np.abs(self.residuals(u))
        # never below half the noise floor nor near zero: a perfect fit would otherwise weigh infinitely
        least = 1e-6 * np.sqrt(np.mean(self.measured**2, axis=1)) + 1e-12
        typical = 1.4826 * np.median(errors, axis=1)
        return np.asarray(np.maximum(np.maximum(typical, 0.5 * self.noise), least), float)

    def cost(self, u: Array) -> float:
        z = self.residuals(u) / self.spread[:, None]
        return float(np.sum(huber_loss(z, self.settings.huber))) + self.prior_cost(u)

    def residual_rms(self, u: Array) -> Array:
        return np.asarray(np.sqrt(np.mean(self.residuals(u) ** 2, axis=1)))

    def normal_equations(self, u: Array) -> tuple[Array, Array]:
        H, g = self.precision.copy(), self.precision @ u
        for _, errors, J in self._linearised(u):
            weighted = J * huber_weight(errors, self.settings.huber)[:, None, :]
            H += np.einsum("cpn,cqn->pq", weighted, J, optimize=True)
            g -= np.einsum("cpn,cn->p", weighted, errors)
        return H, g

    def information_and_scatter(self, u: Array) -> tuple[Array, Array, int]:
        block = time_blocks(self.samples, self.settings.block_s)
        scores = np.zeros((self.size, int(block[-1]) + 1))
        H = np.zeros((self.size, self.size))
        for rows, errors, J in self._linearised(u):
            H += np.einsum("cpn,cqn->pq", J * (np.abs(errors) < self.settings.huber)[:, None, :], J, optimize=True)
            score = np.einsum("cpn,cn->pn", J, huber_weight(errors, self.settings.huber) * errors)
            for i in range(self.size):
                scores[i] += np.bincount(block[rows], score[i], scores.shape[1])
        return H, scores @ scores.T, scores.shape[1]

    def _linearised(self, u: Array) -> Iterator[tuple[slice, Array, Array]]:
        for rows, predicted, J in self.columns.linearise(self.samples.inputs, self.theta(u), self.settings.channels):
            errors = (self.measured[:, rows] - predicted) / self.spread[:, None]
            yield rows, errors, J * (self.scale[:, None] / self.spread[:, None, None])


def huber_weight(z: Array, limit: float) -> Array:
    """Weight that makes squared residuals act like Huber's loss."""
    return np.asarray(np.minimum(1.0, limit / np.maximum(np.abs(z), 1e-12)))


def huber_loss(z: Array, limit: float) -> Array:
    """z^2 / 2 up to `limit`, linear beyond."""
    size = np.abs(z)
    return np.where(size <= limit, 0.5 * size * size, limit * (size - 0.5 * limit))


def time_blocks(samples: Samples, block_s: float) -> NDArray[np.int64]:
    """(n,) number of the time block of each sample; a gap starts a new one."""
    number = np.floor((samples.t - samples.t[0]) / block_s)
    change = np.concatenate([[False], (np.diff(number) != 0) | (np.diff(samples.segment) != 0)])
    return np.cumsum(change).astype(np.int64)


def _gauss_newton(problem: Problem, u: Array, decrease: float) -> tuple[Array, int, bool]:
    """Damped Gauss-Newton within the bounds: (estimate, iterations, whether the step fell below the tolerance)."""
    settings, damping, cost = problem.settings, 1e-6, problem.cost(u)
    coordinates = StepCoordinates(problem.table)
    box = coordinates.box(problem.lower, problem.upper)
    for iteration in range(settings.max_iterations):
        H, g = problem.normal_equations(u)
        if not (np.isfinite(H).all() and np.isfinite(g).all()):
            return u, iteration, False
        T, w = coordinates.tangent(u), coordinates.forward(u)
        while True:
            step = bounded_step(T.T @ H @ T, T.T @ g, w, box, damping)
            trial = _within_reach(problem, coordinates, u, w, step)
            length = math.sqrt(max(float((trial - u) @ H @ (trial - u)), 0.0))
            trial_cost = problem.cost(trial)
            if trial_cost <= cost or length < settings.tolerance or damping > MOST_DAMPING:
                break
            damping = max(10.0 * damping, 1e-3)
        flat = not cost - trial_cost > decrease * cost
        if trial_cost <= cost:
            u, cost, damping = trial, trial_cost, max(0.03 * damping, 1e-9)
        if length < settings.tolerance or flat:
            return u, iteration + 1, True
    return u, settings.max_iterations, False


def _within_reach(problem: Problem, coordinates: StepCoordinates, u: Array, w: Array, step: Array) -> Array:
    """u after the step, shortened to `LONGEST_STEP` and clipped to the bounds."""
    trial = np.clip(coordinates.inverse(w + step), problem.lower, problem.upper)
    longest = float(np.max(np.abs(trial - u)))
    if longest > LONGEST_STEP:
        trial = np.clip(coordinates.inverse(w + step * LONGEST_STEP / longest), problem.lower, problem.upper)
    return np.asarray(trial)


def bounded_step(H: Array, g: Array, u: Array, box: tuple[Array, Array], damping: float) -> Array:
    """Newton step within `box` from u with Levenberg-Marquardt damping; what would leave its bounds stays on them."""
    lower, upper = box
    free = ~(((u <= lower) & (g > 0)) | ((u >= upper) & (g < 0)))
    step = np.zeros_like(u)
    for _ in range(len(u)):
        if not free.any():
            break
        part = H[np.ix_(free, free)]
        part = part + np.diag(damping * np.diag(part) + 1e-12 * (1.0 + np.trace(part)))
        step[free] = -np.linalg.solve(part, g[free] + H[np.ix_(free, ~free)] @ step[~free])
        leaving = free & ((u + step < lower) | (u + step > upper))
        if not leaving.any():
            break
        step[leaving] = np.clip(u + step, lower, upper)[leaving] - u[leaving]
        free &= ~leaving
    return np.asarray(np.clip(u + step, lower, upper) - u)


def _covariance(information: Array, scatter: Array, blocks: int, problem: Problem, free: NDArray[np.bool_]) -> Array:
    """Covariance (p, p), SI, of the free parameters; one that ended on its bound is as uncertain as its prior.

    With many blocks, or strongly correlated residuals, it is the sandwich. With few blocks, whose scatter is itself
    uncertain, and nearly white residuals it tends to the inverse information times their average inflation.
    """
    kept = np.ix_(free, free)
    bread = np.linalg.pinv((information + problem.precision)[kept], hermitian=True)
    meat = (scatter + problem.precision)[kept]
    inflation = max(1.0, float(np.trace(bread @ meat)) / max(int(free.sum()), 1))
    white = inflation < NEARLY_WHITE
    share = blocks / (blocks + BLOCKS_PER_PARAMETER * problem.size) if white else blocks / max(blocks - problem.size, 1)
    scaled = np.eye(problem.size)
    scaled[kept] = share * bread @ meat @ bread + max(1.0 - share, 0.0) * inflation * bread
    return np.asarray(scaled * np.outer(problem.scale, problem.scale))


def _result(problem: Problem, u: Array, iterations: int, converged: bool) -> Fit:
    information, scatter, blocks = problem.information_and_scatter(u)
    free = (u > problem.lower) & (u < problem.upper)
    covariance = _covariance(information, scatter, blocks, problem, free)
    bound = [p.name for p, inside in zip(problem.table, free, strict=True) if not inside]
    return Fit(
        parameters=problem.table,
        theta=problem.theta(u),
        covariance=covariance,
        information=information,
        spread=dict(zip(problem.channels, problem.spread.tolist(), strict=True)),
        rmse=dict(zip(problem.channels, problem.residual_rms(u).tolist(), strict=True)),
        at_bound=tuple(bound),
        iterations=iterations,
        converged=converged,
    )
