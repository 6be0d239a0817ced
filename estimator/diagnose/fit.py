"""Joint fit of tyre and effect parameters, and what it says about data it has not seen.

Gauss-Newton with Levenberg damping on all channels at once. The variance of each channel is estimated along
with the parameters and never below the sensor noise, so that a channel the model cannot explain does not
outweigh the others. Normal equations are kept per held-out group: leaving one out is then one small linear solve.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.diagnose.linearised import Linearised, linearised
from estimator.diagnose.noise import Noise, likeliest
from estimator.diagnose.normal import Normal, accumulate
from estimator.diagnose.predict import Predictor

Array = NDArray[np.float64]

MAX_ITERATIONS = 14
CONVERGED = 0.3, 1e-4
"""A step that lowers the deviance by less, absolutely or relative to all it was lowered by, ends the fit."""


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
    prior = np.array([p.prior for p in predictor.table])
    precision = predictor.prior_precision
    at = evaluate(predictor, parameters, noise)
    normal = Normal(
        *accumulate(at.error, at.sensitivity, record.lap), count,
        precision, -precision @ (parameters - prior), record.block_noise**2,
    )  # fmt: skip
    return normal, at


def fit(predictor: Predictor, start: Array, noise: Noise | None = None, iterations: int = MAX_ITERATIONS) -> Fit:
    """Fit all parameters from `start`; `noise` weighs the channels, default: that of the sensors."""
    noise = noise or Noise.white(predictor.record.block_noise)
    lower, upper = predictor.bounds
    at, axles = np.clip(start, lower, upper), _axles(predictor)
    normal, _ = normal_at(predictor, at, noise)
    first = best = _objective(predictor, normal, at)
    damping = 1e-4
    for _ in range(iterations):
        trial = _damped_step(axles, normal, at, lower, upper, damping)
        new, _ = normal_at(predictor, trial, noise)
        value = _objective(predictor, new, trial)
        if not np.isfinite(value) or value > best:
            if value < best + CONVERGED[0]:
                break
            damping = max(damping, 1e-3) * 10
            if damping > 1e4:
                break
            continue
        gained, best, damping = best - value, value, damping / 10
        at, normal = trial, new
        if gained < CONVERGED[0] + CONVERGED[1] * (first - best):
            break
    return Fit(predictor, at, normal, noise)


def _objective(predictor: Predictor, normal: Normal, at: Array) -> float:
    """Minus twice the log posterior, up to a constant."""
    off = at - np.array([p.prior for p in predictor.table])
    variance, count = normal.variance, normal.count.sum()
    data = (normal.squares.sum(1) / variance + count * np.log(variance)).sum()
    return float(data + off @ normal.prior @ off)


def _damped_step(  # noqa: PLR0917 - one argument per symbol of the step
    axles: Axles, normal: Normal, at: Array, lower: Array, upper: Array, damping: float
) -> Array:
    """Next parameters: a Levenberg-Marquardt step with parameters held that would leave their bounds."""
    pull = normal.pull(normal.variance)
    free = ~(((at <= lower) & (pull < 0)) | ((at >= upper) & (pull > 0)))
    tangent = _tangent(axles, at)[free]
    total = tangent.T @ normal.precision(normal.variance)[np.ix_(free, free)] @ tangent
    scale = np.sqrt(np.maximum(np.diag(total), 1e-300))
    scaled = total / scale[:, None] / scale + (damping + RIDGE) * np.eye(len(scale))
    step = np.linalg.solve(scaled, tangent.T @ pull[free] / scale) / scale
    return np.clip(_advance(axles, at, step), lower, upper)


Axles = list[tuple[int, int, int]]
"""Indices of B, C, D of each axle."""
LARGEST_LOG_STEP = 0.4
RIDGE = 1e-11


def _axles(predictor: Predictor) -> Axles:
    names = [p.name for p in predictor.model.tyre_table]
    axles = [axle for axle in ("", "f", "r") if f"b{axle}" in names]
    return [(names.index(f"b{a}"), names.index(f"c{a}"), names.index(f"d{a}")) for a in axles]


def _tangent(axles: Axles, at: Array) -> Array:
    """Derivative of the parameters by step coordinates: log(B C D), log C, log D instead of B, C, D.

    At small slip only the product shows; in B, C, D themselves the minimum lies in a long curved valley.
    """
    out = np.eye(len(at))
    for b, c, d in axles:
        out[b, b], out[b, c], out[b, d] = at[b], -at[b], -at[b]
        out[c, c], out[d, d] = at[c], at[d]
    return out


def _advance(axles: Axles, at: Array, step: Array) -> Array:
    """Parameters after a step in step coordinates."""
    out = at + step
    for b, c, d in axles:
        stiffness, shape, peak = np.clip(step[[b, c, d]], -LARGEST_LOG_STEP, LARGEST_LOG_STEP)
        out[c], out[d] = at[c] * np.exp(shape), at[d] * np.exp(peak)
        out[b] = at[b] * np.exp(stiffness - shape - peak)
    return out
