"""Joint fit of tyre and effect parameters, and what it says about data it has not seen.

Gauss-Newton with Levenberg damping on all channels at once. The variance of each channel is estimated along
with the parameters and never below the sensor noise, so that a channel the model cannot explain does not
outweigh the others. Normal equations are kept per held-out group: leaving one out is then one small linear solve.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimator.offline.fit.normal import Normal, accumulate
from estimator.offline.fit.steps import Coordinates
from estimator.offline.predict.linearised import Linearised, linearised
from estimator.offline.predict.predict import Predictor
from estimator.offline.record.noise import Noise, likeliest
from hil_gateway.process.arrays import Array

MAX_ITERATIONS = 14
CONVERGED = 0.3, 1e-4
"""A step that lowers the deviance by less, absolutely or relative to all it was lowered by, ends the fit."""
RELIEF = 10.0
"""by which damping falls after a good step; its root after each step that was too long"""


@dataclass(frozen=True)
class Fit:
    """A fitted model on one record: parameters (p,) and the normal equations there."""

    predictor: Predictor
    parameters: Array
    normal: Normal
    noise: Noise

    @property
    def covariance(self) -> Array:
        """(p, p) of the parameters, as if residuals were white."""
        return np.asarray(np.linalg.pinv(self.normal.precision(self.normal.variance), hermitian=True), np.float64)

    @property
    def slow_variance(self) -> Array:
        """(p,) variance of the parameters if residuals of a stretch (30 s) say one thing: sandwich over stretches."""
        scores = np.einsum("clp,c->pl", self.normal.gradient, 1.0 / self.normal.variance)
        stretches, spread = scores.shape[1], self.covariance @ scores
        return np.asarray(np.sum(spread**2, axis=1) * stretches / max(stretches - 1, 1))

    @property
    def deviation(self) -> Array:
        """(5,) standard deviation of the residuals of each channel."""
        return np.sqrt(self.normal.variance)

    def new_noise(self) -> Noise:
        """The noise that the residuals show."""
        at = evaluate(self.predictor, self.parameters, self.noise)
        deviation = np.maximum(self.deviation / at.innovations.scale, self.predictor.record.block_noise)

        def deviance(noise: Noise) -> float:
            error, _ = at.error_under(noise)
            return float(np.log(np.mean(error[at.record.used] ** 2, axis=(1, 2))).sum())

        return likeliest(Noise(deviation, self.noise.drift), at.record.used, deviance)

    def held_out(self) -> Array:
        """(5, laps) sum of squared residuals of each lap, predicted by a fit to all the others."""
        return self.normal.held_out(self.normal.variance)


def evaluate(predictor: Predictor, parameters: Array, noise: Noise) -> Linearised:
    """Residual and sensitivity of the measured signals."""
    return linearised(predictor.record, *predictor.linearise(parameters), noise)


def normal_at(predictor: Predictor, parameters: Array, noise: Noise) -> tuple[Normal, Linearised]:
    """Normal equations at `parameters`."""
    record = predictor.record
    laps = int(record.lap.max()) + 1
    count = np.array([np.count_nonzero(record.lap == lap) for lap in range(laps)]) * float(record.rows.shape[1])
    precision = predictor.prior_precision
    at = evaluate(predictor, parameters, noise)
    normal = Normal(
        *accumulate(at.error, at.sensitivity, record.lap), count,
        precision, -precision @ (parameters - predictor.prior), record.block_noise**2,
    )  # fmt: skip
    return normal, at


def fit(
    predictor: Predictor,
    start: Array,
    noise: Noise | None = None,
    iterations: int = MAX_ITERATIONS,
    least: float = CONVERGED[0],
) -> Fit:
    """Fit all parameters from `start`; `noise` weighs the channels, default: that of the sensors.

    A step that lowers the deviance by less than `least` is the last.
    """
    noise = noise or Noise.white(predictor.record.block_noise)
    lower, upper = predictor.bounds
    at = np.clip(start, lower, upper)
    coordinates = Coordinates.of([p.name for p in predictor.model.tyre_table], lower, upper)
    normal, _ = normal_at(predictor, at, noise)
    first = best = _objective(predictor, normal, at)
    damping, relief = 1e-4, RELIEF
    for _ in range(iterations):
        trial = coordinates.damped_step(normal, at, damping)
        new, _ = normal_at(predictor, trial, noise)
        value = _objective(predictor, new, trial)
        if not np.isfinite(value) or value > best:
            if value < best + least:
                break
            damping, relief = max(damping, 1e-3) * 10, np.sqrt(relief)
            if damping > 1e4:
                break
            continue
        gained, best, damping = best - value, value, damping / relief
        at, normal = trial, new
        if gained < least + CONVERGED[1] * (first - best):
            break
    return Fit(predictor, at, normal, noise)


def _objective(predictor: Predictor, normal: Normal, at: Array) -> float:
    """Minus twice the log posterior, up to a constant."""
    off = at - predictor.prior
    variance, count = normal.variance, normal.count.sum()
    data = (normal.squares.sum(1) / variance + count * np.log(variance)).sum()
    return float(data + off @ normal.prior @ off)
