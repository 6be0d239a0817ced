"""Whether anything is left to explain: a residual that is white in time has no structure a model could take out."""

from __future__ import annotations

import numpy as np

from estimator.offline.fit.normal import TINY
from estimator.offline.fit.prediction_error import Fit, residual
from estimator.offline.predict.predict import LATERAL, Predictor
from estimator.offline.record.noise import Noise
from hil_gateway.process.arrays import Array

SLOW_BLOCKS = 5
"""Residuals are averaged over so many blocks (0.2 s)."""


def slow_ratio(predictor: Predictor, parameters: Array, deviation: Array) -> Array:
    """(5,) variance of averages of the residual over 0.2 s, relative to what it would be for white noise."""
    error = residual(predictor, parameters, Noise.white(deviation))
    blocks = error.shape[2] // SLOW_BLOCKS * SLOW_BLOCKS
    averages = error[:, :, :blocks].reshape(*error.shape[:2], -1, SLOW_BLOCKS).mean(axis=3)
    ratio: Array = SLOW_BLOCKS * np.mean(averages**2, axis=(1, 2)) / np.maximum(np.mean(error**2, axis=(1, 2)), TINY)
    return ratio


def structured(fit: Fit, limit: float) -> bool:
    """Whether the residual of any channel varies slowly by more than `limit` times white noise."""
    return bool(np.any(slow_ratio(fit.predictor, fit.parameters, fit.deviation) > limit))


def laterally_structured(fit: Fit, limit: float) -> bool:
    """The same of the lateral channels and the yaw rate alone."""
    return bool(np.any(slow_ratio(fit.predictor, fit.parameters, fit.deviation)[list(LATERAL)] > limit))
