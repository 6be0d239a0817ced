"""The paper's two recursive methods: a batch of 100 samples at a time (section III), and Eq. (8) sample by sample."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from estimator.belief.tyre_belief import BeliefSettings, Sample, TyreBelief
from estimator.model.columns import ModelColumns
from estimator.model.single_track import AUXILIARY, SIGNALS
from estimator.offline.fit.equation_error import Fit, rmse
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


@dataclass(frozen=True)
class Recursion:
    """Result of a recursive method: the estimate in the same form as a fit, and its RMSE curve."""

    fit: Fit
    curve: tuple[CurvePoint, ...]


def averaged(samples: Samples) -> Samples:
    """`samples` averaged over `AVERAGE_S`, at the rate that leaves."""
    return samples.thin(max(1, round(AVERAGE_S / samples.step)))


def batch(
    columns: ModelColumns, train: Samples, held_out: Samples, progress: Progress = lambda share: None
) -> Recursion:
    """One averaged update of the estimate for every `BATCH` samples, each linearised once (paper, section III).

    The first pass goes through the data as the paper does and gives the RMSE curve. Its early linearisations were
    made far from the answer, so a second pass accumulates the same batches linearised at the end of the first.
    """
    total = -(-len(train) // BATCH)
    every = max(1, total // CURVE_POINTS)
    curve = [CurvePoint(0, rmse(columns, held_out, columns.start, CURVE_CHANNELS))]
    for number, state in enumerate(_moving_pass(columns, train), start=1):
        if number % every == 0 or number == total:
            curve.append(CurvePoint(number, rmse(columns, held_out, state.theta, CURVE_CHANNELS)))
            progress(0.5 * number / total)
    for _ in range(RELINEARISED_PASSES):
        state = _fixed_pass(columns, train, state.theta)
    progress(1.0)
    return Recursion(_as_fit(columns, train, state, total), tuple(curve))


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


def _fixed_pass(columns: ModelColumns, samples: Samples, theta: Array) -> _State:
    """All batches linearised at `theta`; of each, only as many samples count as are independent."""
    whole = AlgebraicProblem(columns, samples, FitSettings(prior=False))
    u = whole.scaled(theta)
    spread, share = whole.robust_spread(u), 1.0 / correlation_time(columns, samples, theta)
    information, right = np.eye(len(u)), np.zeros(len(u))
    for problem in _batches(columns, samples):
        problem.spread = spread
        H, g = problem.normal_equations(u)
        information += share * H
        right += share * (H @ u - g)
    return _State(whole.theta(np.clip(np.linalg.solve(information, right), whole.lower, whole.upper)), information)


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


def _as_fit(columns: ModelColumns, samples: Samples, state: _State, updates: int) -> Fit:
    problem = AlgebraicProblem(columns, samples, FitSettings(prior=False))
    scale = np.outer(problem.scale, problem.scale)
    u = problem.scaled(state.theta)
    at_bound = (u <= problem.lower) | (u >= problem.upper)
    return Fit(
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
    theta = _fixed_pass(columns, train, _last(_moving_pass(columns, train)).theta).theta
    nuisance = theta[len(columns.model.tyre_table) :]
    problem = AlgebraicProblem(columns, train, FitSettings(prior=False))
    noise = problem.robust_spread(problem.scaled(theta))
    settings = _belief_settings(noise, correlation_time(columns, train, theta))
    belief = TyreBelief(columns.model, settings)
    curve = [CurvePoint(0, rmse(columns, held_out, columns.start, CURVE_CHANNELS))]
    every = max(1, len(train) // CURVE_POINTS)
    for i, one in enumerate(_samples_of(train, nuisance), start=1):
        belief.update(one, train.step)
        if i % every == 0:
            here = np.concatenate([belief.mean, nuisance])
            curve.append(CurvePoint(i, rmse(columns, held_out, here, CURVE_CHANNELS)))
            progress(0.5 * i / len(train))
    again = TyreBelief(columns.model, settings)
    again.deviation = belief.deviation
    again.scaled_covariance = REPEAT_INFLATION * belief.scaled_covariance
    for one in _samples_of(train, nuisance):
        again.update(one, train.step)
    information = np.eye(len(theta))
    known = len(again.mean)
    information[:known, :known] = np.linalg.inv(again.scaled_covariance)
    state = _State(np.concatenate([again.mean, nuisance]), information)
    return Recursion(_as_fit(columns, train, state, again.samples), tuple(curve))


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


def _last(states: Iterator[_State]) -> _State:
    for state in states:
        last = state
    return last
