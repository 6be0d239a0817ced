"""The paper's two recursive methods: a batch of 100 samples at a time (section III), and Eq. (8) sample by sample."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from estimator.belief.tyre_belief import BeliefSettings, Sample, TyreBelief
from estimator.model.columns import ModelColumns
from estimator.model.single_track import AUXILIARY, SIGNALS
from estimator.offline.fit.equation_error import EquationErrorFit, rmse
from estimator.offline.fit.problem import AlgebraicProblem, FitSettings
from estimator.offline.record.prepare import Samples
from hil_gateway.process.arrays import Array

BATCH = 100
"""Samples a batch, as in section III of the paper."""

CURVE_POINTS = 150
"""Points of the RMSE curve at most."""

SPREAD_MEMORY = 0.1
"""Share of a batch in the running variance of the residuals."""

AVERAGE_S = 0.04
"""Samples are averages over so long: noise in the states bends the tyre curve less."""

Progress = Callable[[float], None]


@dataclass(frozen=True)
class CurvePoint:
    """RMSE on held-out samples after so many batches (or as many samples)."""

    batch: int
    rmse: dict[str, float]


Curve = tuple[CurvePoint, ...]


@dataclass(frozen=True)
class Recursion:
    """Result of a recursive method: the estimate in the same form as a fit, and how it was reached.

    `curve` ends with the errors of `fit`; `as_published` is that of the paper's update (section III), whose estimate is
    not reported. Both begin with the initial parameters.
    """

    fit: EquationErrorFit
    curve: Curve
    as_published: Curve = ()


def averaged(samples: Samples) -> Samples:
    """`samples` averaged over `AVERAGE_S`, at the rate that leaves."""
    return samples.thin(max(1, round(AVERAGE_S / samples.step)))


def batch(
    columns: ModelColumns, train: Samples, held_out: Samples, progress: Progress = lambda share: None
) -> Recursion:
    """One update of the estimate for every `BATCH` samples, in the paper's way (section III) and in a refined one.

    Refined, a batch counts for as many samples as are independent. The early linearisations of a first pass are made
    far from the answer, so the same batches are accumulated again, linearised at the end of the pass before.
    """
    total = -(-len(train) // BATCH)

    def curve(states: Iterable[_State], begin: float, end: float) -> tuple[Curve, _State]:
        return _curve(columns, held_out, states, total, lambda share: progress(begin + (end - begin) * share))

    as_published, _ = curve(_published_pass(columns, train), 0.0, 0.5)
    theta = _last(_moving_pass(columns, train)).theta
    for _ in range(RELINEARISED_PASSES - 1):
        theta = _last(_fixed_pass(columns, train, theta)).theta
    refined, state = curve(_fixed_pass(columns, train, theta), 0.5, 1.0)
    return Recursion(_as_fit(columns, train, state, total), refined, as_published)


def _curve(
    columns: ModelColumns, held_out: Samples, states: Iterable[_State], total: int, progress: Progress
) -> tuple[Curve, _State]:
    """`CURVE_POINTS` of the errors of `total` states, and the last state."""
    every = max(1, total // CURVE_POINTS)
    points = [CurvePoint(0, rmse(columns, held_out, columns.start, CURVE_CHANNELS))]
    for number, state in enumerate(states, start=1):
        if number % every == 0 or number == total:
            points.append(CurvePoint(number, rmse(columns, held_out, state.theta, CURVE_CHANNELS)))
            progress(number / total)
    return tuple(points), state


RELINEARISED_PASSES = 2

REPEAT_INFLATION = 25.0
"""Covariance with which the second sample-by-sample pass starts: the first counts for a 25th of the information."""

CURVE_CHANNELS = ("ax", "ay", "yaw_acc")


@dataclass(frozen=True)
class _State:
    """Mean (p,) and information (p, p) in scaled units after some batches."""

    theta: Array
    information: Array


def _batches(columns: ModelColumns, samples: Samples) -> Iterator[AlgebraicProblem]:
    settings = FitSettings(prior=False)
    for start in range(0, len(samples), BATCH):
        yield AlgebraicProblem(columns, samples.select_range(start, start + BATCH), settings)


def _moving_pass(columns: ModelColumns, samples: Samples) -> Iterator[_State]:
    """States after each batch, each linearised at the estimate before it; the spread follows the residuals."""
    whole = AlgebraicProblem(columns, samples, FitSettings(prior=False))
    u = whole.scaled(columns.start)
    variance = whole.first_spread(u) ** 2
    information = np.eye(len(u))
    for problem in _batches(columns, samples):
        variance += SPREAD_MEMORY * (np.maximum(problem.residual_rms(u), 0.5 * whole.noise) ** 2 - variance)
        problem.spread = np.sqrt(variance)
        H, g = problem.normal_equations(u)
        information = information + H
        u = np.clip(u - np.linalg.solve(information, g), whole.lower, whole.upper)
        yield _State(whole.theta(u), information)


def _published_pass(columns: ModelColumns, samples: Samples) -> Iterator[_State]:
    """States after each batch as the paper takes them: loss and descent direction averaged over the batch, which so
    counts for one sample, linearised once at the estimate before it; Sigma_z is constant, what the initial parameters
    leave."""
    whole = AlgebraicProblem(columns, samples, FitSettings(prior=False))
    u = whole.scaled(columns.start)
    spread, information = whole.first_spread(u), np.eye(len(u))
    for problem in _batches(columns, samples):
        problem.spread = spread
        H, g = problem.normal_equations(u)
        information = information + H / len(problem.samples)
        u = np.clip(u - np.linalg.solve(information, g / len(problem.samples)), whole.lower, whole.upper)
        yield _State(whole.theta(u), information)


def _fixed_pass(columns: ModelColumns, samples: Samples, theta: Array) -> Iterator[_State]:
    """States after each batch, all linearised at `theta`; of each, only as many samples count as are independent."""
    whole = AlgebraicProblem(columns, samples, FitSettings(prior=False))
    u = whole.scaled(theta)
    spread, share = whole.robust_spread(u), 1.0 / correlation_time(columns, samples, theta)
    information, right = np.eye(len(u)), np.zeros(len(u))
    for problem in _batches(columns, samples):
        problem.spread = spread
        H, g = problem.normal_equations(u)
        information = information + share * H
        right = right + share * (H @ u - g)
        estimate = np.clip(np.linalg.solve(information, right), whole.lower, whole.upper)
        yield _State(whole.theta(estimate), information)


def correlation_time(columns: ModelColumns, samples: Samples, theta: Array) -> float:
    """Over how many samples the residuals stay correlated: 1 + 2 sum of autocorrelations up to the first negative."""
    problem = AlgebraicProblem(columns, samples, FitSettings(prior=False))
    times = [_integrated_autocorrelation(e - e.mean()) for e in problem.residuals(problem.scaled(theta))]
    return float(np.mean(times))


def _integrated_autocorrelation(errors: Array) -> float:
    n = len(errors)
    power = np.abs(np.fft.rfft(errors, 2 * n)) ** 2
    correlation = np.fft.irfft(power)[: n // 4]
    correlation /= max(float(correlation[0]), 1e-300)
    negative = np.flatnonzero(correlation < 0.0)
    stop = int(negative[0]) if negative.size else len(correlation)
    return float(1.0 + 2.0 * np.sum(correlation[1:stop]))


def _as_fit(columns: ModelColumns, samples: Samples, state: _State, updates: int) -> EquationErrorFit:
    problem = AlgebraicProblem(columns, samples, FitSettings(prior=False))
    scale = np.outer(problem.scale, problem.scale)
    u = problem.scaled(state.theta)
    at_bound = (u <= problem.lower) | (u >= problem.upper)
    return EquationErrorFit(
        parameters=problem.table,
        theta=state.theta,
        covariance=np.asarray(np.linalg.inv(state.information) * scale, float),
        information=state.information - np.eye(len(u)),
        spread=dict(zip(problem.channels, problem.robust_spread(u).tolist(), strict=True)),
        rmse=dict(zip(problem.channels, problem.residual_rms(u).tolist(), strict=True)),
        at_bound=tuple(p.name for p, b in zip(problem.table, at_bound, strict=True) if b),
        iterations=updates,
        converged=True,
    )


def sample(
    columns: ModelColumns, train: Samples, held_out: Samples, progress: Progress = lambda share: None
) -> Recursion:
    """Eq. (8) per sample in Joseph form: the recursion the estimator process runs live.

    Like the batches it goes twice through the data, since its first linearisations were made far from the answer;
    the second time it starts from the first estimate with its covariance inflated. Nuisance parameters are those of
    the batches.
    """
    theta = _last(_fixed_pass(columns, train, _last(_moving_pass(columns, train)).theta)).theta
    nuisance = theta[len(columns.model.tyre_table) :]
    problem = AlgebraicProblem(columns, train, FitSettings(prior=False))
    noise = problem.robust_spread(problem.scaled(theta))
    settings = _belief_settings(noise, correlation_time(columns, train, theta))
    belief = TyreBelief(columns.model, settings)
    curve, state = _curve(columns, held_out, _two_passes(belief, train, nuisance), 2 * len(train), progress)
    return Recursion(_as_fit(columns, train, state, belief.samples), curve)


def _two_passes(belief: TyreBelief, samples: Samples, nuisance: Array) -> Iterator[_State]:
    """States after each sample; the nuisance parameters stay."""
    known = len(belief.mean)
    for inflation in (REPEAT_INFLATION, None):
        for one in _samples_of(samples, nuisance):
            belief.update(one, samples.step)
            information = np.eye(known + len(nuisance))
            information[:known, :known] = np.linalg.inv(belief.scaled_covariance)
            yield _State(np.concatenate([belief.mean, nuisance]), information)
        if inflation is not None:
            belief.scaled_covariance = inflation * belief.scaled_covariance


def _belief_settings(noise: Array, correlated: float) -> BeliefSettings:
    names = ("imu_ax", "imu_ay", "yaw_acc")
    return BeliefSettings(
        kind="imu_yaw",
        std=dict(zip(names, noise.tolist(), strict=True)),
        correlation_samples=correlated,
        min_speed=0.0,
        min_slip=0.0,
        min_drive=0.0,
    )


def _samples_of(samples: Samples, phi: Array) -> Iterator[Sample]:
    covariance = np.zeros((3, 3))  # what is left of the noise in the states is in the spread of the residuals already
    k = len(SIGNALS)
    for i in range(len(samples)):
        inputs = samples.inputs[:, i]
        yield Sample(inputs[:k], covariance, samples.channels[:3, i], inputs[k : k + len(AUXILIARY)], phi)


def _last(states: Iterable[_State]) -> _State:
    for state in states:
        last = state
    return last
