"""How far the parameters of a diagnosis may be off: by noise, by what scatters from stretch to stretch, by what is
declared, by when the sensors were read, and by empirical terms beside them."""

from __future__ import annotations

import numpy as np

from estimator.offline.fit.held import UNIFORM, by_declared, by_sampling, by_zero
from estimator.offline.fit.prediction_error import Fit, Point
from estimator.offline.record.unknown_inputs import SAMPLED
from estimator.offline.search.trial import warm_start
from hil_gateway.process.arrays import Array


def covariance(fit: Fit, without: Fit | None = None) -> Array:
    """(p, p) of the parameters; `without` is the same fit without splines, where it has some.

    A spline of one signal can take a part of any effect along: which of both is right no residual tells, so that a size
    is as unsure as it moves without the spline.
    """
    ideal = fit.covariance
    longer = np.sqrt(np.maximum(np.maximum(_within_windows(fit), fit.jackknife_variance) / np.diag(ideal), 1.0))
    moves = np.concatenate([by_sampling(fit), by_declared(fit), by_zero(fit), _by_splines(fit, without)])
    found = ideal * np.outer(longer, longer) + moves.T @ moves
    for block in fit.predictor.blocks:
        if block.effect.name in SAMPLED:  # its own shift within a row is not fitted beside it
            found[block.parameters, block.parameters] += (fit.predictor.record.step * UNIFORM) ** 2
    return np.asarray(found)


def without_splines(fit: Fit, without: Fit) -> Array:
    """(p,) parameters of `fit` as they are in the same fit without splines."""
    return warm_start(fit.predictor, fit.parameters.copy(), without)


def _by_splines(fit: Fit, without: Fit | None) -> Array:
    """(1, p) by which the parameters move where splines are left out."""
    moved = fit.parameters if without is None else without_splines(fit, without)
    return np.asarray(moved - fit.parameters)[None]


def _within_windows(fit: Fit) -> Array:
    """(p,) variance of the parameters where residuals of a window of 2 s may be correlated."""
    at = Point.at(fit.predictor, fit.parameters, fit.noise)
    weighted = at.left.error / fit.normal.variance[:, None, None]
    scores = np.einsum("cpwb,cwb->pw", at.sensitivity.dense, weighted, optimize=True)
    return np.asarray(np.sum((fit.covariance @ scores) ** 2, axis=1))
