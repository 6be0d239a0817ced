"""The diagnosed model as estimator and planner get it: no surer of itself than its residual allows.

A residual that lasts for seconds is not so many independent samples. Counted as if it were, it drives parameters that
the driving did not determine (peak and shape of a tyre far from its peak) wherever they absorb a little of what the
model still lacks, and a planner that trusts them brakes too early or too late. Here every channel counts only as often
as its residual is independent, so that such directions stay at the prior (a tempered posterior: Grünwald and
van Ommen 2017, "Inconsistency of Bayesian inference for misspecified linear models").
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from estimator.model.single_track import SingleTrack
from estimator.offline.fit.normal import TINY
from estimator.offline.fit.prediction_error import Fit, Point, fit, residual
from estimator.offline.predict.predict import Predictor
from estimator.offline.record.noise import ResidualNoise
from estimator.offline.record.record import Record
from hil_gateway.process.arrays import Array


def tempered(model: SingleTrack, parameters: Array, record: Record, deviation: Array) -> Fit:
    """Fit of `model` on `record` from `parameters`; `deviation` (5,) of the residuals as first found."""
    predictor = Predictor(model, record)
    found = np.sqrt(Point.at(predictor, parameters, ResidualNoise.white(deviation)).normal().variance)
    repeats = _repeats(predictor, parameters, found)
    careful = replace(record, noise=found * np.sqrt(repeats * record.rows.shape[2]))
    return fit(Predictor(model, careful), parameters, ResidualNoise.white(found))


def _repeats(predictor: Predictor, parameters: Array, deviation: Array) -> Array:
    """(5,) residuals that say the same: variance of their mean over a window, relative to independent ones."""
    error = residual(predictor, parameters, ResidualNoise.white(deviation))
    means = error.mean(axis=2)
    same = error.shape[2] * np.mean(means**2, axis=1) / np.maximum(np.mean(error**2, axis=(1, 2)), TINY)
    return np.asarray(np.maximum(1.0, same))
