"""Joint fit of tyre and effect parameters, and what it says about data it has not seen.

Gauss-Newton with Levenberg damping on all channels at once. The variance of each channel is estimated along
with the parameters and never below the sensor noise, so that a channel the model cannot explain does not
outweigh the others. Normal equations are kept per held-out group: leaving one out is then one small linear solve.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from estimator.offline.fit.normal import Normal, accumulate, inverse
from estimator.offline.fit.steps import Coordinates
from estimator.offline.predict.linearised import Linearised, linearised
from estimator.offline.predict.predict import Predictor
from estimator.offline.record.noise import ResidualNoise, likeliest
from estimator.offline.record.record import Record
from estimator.offline.record.window_columns import WindowColumns
from hil_gateway.process.arrays import Array

MAX_ITERATIONS = 14
CONVERGED = 0.03, 1e-4
"""A fit ends where an undamped step is predicted to lower the deviance by less, absolutely or relative to all it was
lowered by: no parameter would move by a fifth of its standard deviation. What the last step gained says less: in a
curved valley short ones gain little long before its end, and a good one much that is not to be had again."""
SETTLED = 0.01
"""Predicted fall of the deviance below which a step is not made: no parameter would move by more than a tenth of its
standard deviation."""
REWEIGH_ABOVE = 0.1
"""A fit goes on with the deviations that its residuals show if these changed by more than a tenth."""
FIRST_DAMPING, RELIEF = 1e-4, 10.0
"""of the steps; factor by which damping falls after a good step; its root after each step that was too long"""


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted model on one record: parameters (p,) and the normal equations there; equal to itself alone.

    `by_sampling` is what `fixed_parameters` says of it where another process was asked already.
    """

    predictor: Predictor
    parameters: Array
    normal: Normal
    noise: ResidualNoise
    by_sampling: Array | None = None

    @property
    def covariance(self) -> Array:
        """(p, p) of the parameters, as if residuals were white."""
        return inverse(self.normal.precision(self.normal.variance))

    @property
    def slow_variance(self) -> Array:
        """(p,) variance of the parameters if residuals of a stretch (30 s) say one thing: sandwich over stretches."""
        scores = np.einsum("clp,c->pl", self.normal.gradient, 1.0 / self.normal.variance)
        stretches, spread = scores.shape[1], self.covariance @ scores
        return np.asarray(np.sum(spread**2, axis=1) * stretches / max(stretches - 1, 1))

    @property
    def squares(self) -> Array:
        """(5, windows) mean square of what is left in each window."""
        return np.asarray(np.mean(residual(self.predictor, self.parameters, self.noise) ** 2, axis=2))

    @property
    def deviation(self) -> Array:
        """(5,) standard deviation of the residuals of each channel."""
        return np.sqrt(self.normal.variance)

    def held_out(self) -> Array:
        """(5, laps) sum of squared residuals of each lap, predicted by a fit to all the others."""
        return self.normal.left_out


@dataclass(frozen=True)
class Point:
    """A model linearised at some parameters (p,): what it leaves under one noise, and its columns under any."""

    predictor: Predictor
    parameters: Array
    noise: ResidualNoise
    left: Linearised
    columns: WindowColumns

    @classmethod
    def at(cls, predictor: Predictor, parameters: Array, noise: ResidualNoise) -> Point:
        """Evaluate the model there."""
        values, state_by, columns = predictor.linearise(parameters)
        left = linearised(predictor.record, values, state_by, noise)
        return cls(predictor, parameters, noise, left, columns)

    @property
    def sensitivity(self) -> WindowColumns:
        """Of the measured signals, whitened."""
        return self.left.sensitivity(self.columns)

    def normal(self) -> Normal:
        """Normal equations."""
        record, predictor = self.predictor.record, self.predictor
        precision = predictor.prior_precision
        return Normal(
            *accumulate(self.left.error, self.sensitivity, record.lap), residual_counts(record),
            precision, -precision @ (self.parameters - predictor.prior), record.block_noise**2,
        )  # fmt: skip

    def under(self, noise: ResidualNoise) -> Point:
        """The same with other noise."""
        return replace(self, noise=noise, left=self.left.under(noise))

    def likeliest_noise(self, deviation: Array) -> ResidualNoise:
        """The noise that the residuals show; `deviation` (5,) of the whitened ones."""
        used = self.predictor.record.used
        white = np.maximum(deviation / self.left.innovations.scale, self.predictor.record.block_noise)

        def deviance(noise: ResidualNoise) -> float:
            error, _ = self.left.error_under(noise)
            return float(np.log(np.mean(error[used] ** 2, axis=(1, 2))).sum())

        return likeliest(ResidualNoise(white, self.noise.drift), used, deviance)


def residual_counts(record: Record) -> Array:
    """(laps,) residuals of a channel in each group that is held out together."""
    return np.asarray(np.bincount(record.lap).astype(np.float64) * record.rows.shape[1])


def residual(predictor: Predictor, parameters: Array, noise: ResidualNoise) -> Array:
    """(5, windows, blocks) what the model leaves of the measured signals, whitened."""
    return linearised(predictor.record, *predictor.linearise_motion(parameters), noise).error


def fit(
    predictor: Predictor,
    start: Array,
    noise: ResidualNoise | None = None,
    iterations: int = MAX_ITERATIONS,
    *,
    least: float = CONVERGED[0],
    reweighings: int = 0,
) -> Fit:
    """Fit all parameters from `start`; `noise` weighs the channels, default: that of the sensors.

    It ends where a step would lower the deviance by less than `least`.
    At the end the noise is estimated from the residuals up to `reweighings` times, and the fit goes on from there.
    """
    noise = noise or ResidualNoise.white(predictor.record.block_noise)
    point = Point.at(predictor, np.clip(start, *predictor.bounds), noise)
    point, normal = _descended(point, iterations, least)
    for _ in range(reweighings):
        found = point.likeliest_noise(np.sqrt(normal.variance))
        if found.close_to(point.noise, REWEIGH_ABOVE):
            break
        point, normal = _descended(point.under(found), iterations, least)
    return Fit(predictor, point.parameters, normal, point.noise)


def _descended(point: Point, iterations: int, least: float) -> tuple[Point, Normal]:
    """The minimum from `point` on, and the normal equations there."""
    predictor = point.predictor
    coordinates = Coordinates.of([p.name for p in predictor.model.tyre_table], *predictor.bounds)
    normal = point.normal()
    first = best = _objective(point, normal)
    damping, relief = FIRST_DAMPING, RELIEF
    for _ in range(iterations):
        trial, fall = coordinates.damped_step(normal, point.parameters, damping)
        if 0.0 <= fall < SETTLED:
            break
        value = np.inf
        if fall >= 0.0:  # a step that its bounds cut short may be predicted to climb: it is not worth a look
            tried = Point.at(predictor, trial, point.noise)
            new = tried.normal()
            value = _objective(tried, new)
        enough = least + CONVERGED[1] * (first - best)
        if not np.isfinite(value) or value > best:
            if value < best + least and fall < enough:
                break
            damping, relief = max(damping, FIRST_DAMPING) * 10, np.sqrt(relief)
            if damping > 1e4:
                break
            continue
        best, damping = value, damping / relief
        point, normal = tried, new
        if coordinates.damped_step(normal, point.parameters, 0.0)[1] < enough:
            break
    return point, normal


def _objective(point: Point, normal: Normal) -> float:
    """Minus twice the log posterior, up to a constant."""
    off = point.parameters - point.predictor.prior
    variance, count = normal.variance, normal.count.sum()
    data = (normal.squares.sum(1) / variance + count * np.log(variance)).sum()
    return float(data + off @ normal.prior @ off)
