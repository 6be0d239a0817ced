"""How far the parameters of a diagnosis may be off: by noise, by what scatters from stretch to stretch and from
lap to lap, by what is declared, by when the sensors were read, and by empirical terms beside them; and which of them
are significant.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import ndtri

from estimator.model.effect import Effect
from estimator.offline.fit.fixed_parameters import UNIFORM, by_declared, by_sampling, by_zero
from estimator.offline.fit.prediction_error import Fit, Point
from estimator.offline.predict.places import PLACES, TermPlace, term_effect
from estimator.offline.predict.predict import Block, Predictor
from estimator.offline.result.leftover import PLACED
from estimator.offline.search.plausible import LEAST_STRETCHES
from estimator.offline.search.trial import warm_start
from hil_gateway.process.arrays import Array

FALSE_ALARM = 0.05
"""Probability that of effects none of which is there one is told from nothing."""
DRIVEN = 0.01, 0.99
"""Quantiles of what a term is over a drive: beyond them are seconds."""


def covariance(fit: Fit, without: Fit | None = None) -> Array:
    """(p, p) of the parameters; `without` is the same fit without splines, where it has some.

    A spline of one signal can take a part of any effect along: which of both is right no residual tells, so that a size
    is as unsure as it moves without the spline, and a constant that one has the law of as unsure as that takes it back.
    """
    ideal = fit.covariance
    scatter = np.max([_within_windows(fit), fit.normal.jackknife_variance, _between_laps(fit)], axis=0)
    longer = np.sqrt(np.maximum(scatter / np.diag(ideal), 1.0))
    moves = np.concatenate([by_sampling(fit), by_declared(fit), by_zero(fit), _by_splines(fit, without)])
    found = ideal * np.outer(longer, longer) + moves.T @ moves
    for block in fit.predictor.blocks:
        if block.effect.shifts:  # its own shift within a row is not fitted beside it
            found[block.parameters, block.parameters] += (fit.predictor.record.step * UNIFORM) ** 2
    return np.asarray(found)


def _by_splines(fit: Fit, without: Fit | None) -> Array:
    """(1, p) by which the parameters move where splines are left out, or are taken for the constant they take back."""
    left_out = fit.parameters if without is None else warm_start(fit.predictor, fit.parameters.copy(), without)
    moves = np.stack([left_out, taken_back(fit)]) - fit.parameters
    return np.asarray(np.take_along_axis(moves, np.abs(moves).argmax(axis=0)[None], axis=0))


def taken_back(fit: Fit) -> Array:
    """(p,) parameters with each effect that a spline of one signal has the law of as small as both are together.

    The level of such a spline is a convention: a constant force beside one that takes it back wherever the drive pushes
    no more is as little a resistance as it is a drive. What is taken back at one place, or for some time, is something
    else there.
    """
    sizes = fit.parameters.copy()
    blocks = {block.effect.name: block for block in fit.predictor.blocks}
    for place_name, place in PLACES.items():
        constant = next((b for b in fit.predictor.blocks if b.effect.constant_at == place_name), None)
        for term in blocks.values():
            beside = term.effect.name == term_effect(place_name, term.effect.cause).name
            if constant is not None and beside and term.effect.cause not in PLACED:
                sizes[constant.parameters] += _smallest_change(fit, place, constant, term)
    return sizes


def _smallest_change(fit: Fit, place: TermPlace, constant: Block, term: Block) -> float:
    """What leads from the size of a constant effect to the smallest that it is together with the term."""
    record, prior = fit.predictor.record, fit.predictor.table[constant.parameters][0].prior
    signal = record.signals[term.effect.profile][record.rows].ravel()
    values = record.bases[term.effect.profile].matrix(signal) @ fit.parameters[term.parameters]
    off = float(fit.parameters[constant.parameters][0]) - prior
    together = np.sort(off + place.constant_per_unit(record.vehicle) * np.quantile(values, DRIVEN))
    return float(np.clip(0.0, *together)) - off


def _between_laps(fit: Fit) -> Array:
    """(p,) variance of the parameters by leaving out laps of the drive in turn; none where there are few.

    What the model lacks acts alike in every stretch of 30 s at one pace, and differs from gentle laps to hard ones.
    """
    record, laps = fit.predictor.record, np.unique(fit.predictor.record.window_laps, return_inverse=True)[1]
    if laps.max() + 1 < LEAST_STRETCHES:
        return np.zeros(len(fit.parameters))
    by_lap = Predictor(fit.predictor.model, replace(record, lap=laps))
    return Point.at(by_lap, fit.parameters, fit.noise).normal().jackknife_variance


def _within_windows(fit: Fit) -> Array:
    """(p,) variance of the parameters where residuals of a window of 2 s may be correlated."""
    at = Point.at(fit.predictor, fit.parameters, fit.noise)
    weighted = at.left.error / fit.normal.variance[:, None, None]
    scores = np.einsum("cpwb,cwb->pw", at.sensitivity.dense, weighted, optimize=True)
    return np.asarray(np.sum((fit.covariance @ scores) ** 2, axis=1))


def critical_errors(candidates: Sequence[Effect]) -> float:
    """Standard errors that every size of the `candidates` stays within, 1 - `FALSE_ALARM`, where none is there.

    The bound of Bonferroni: each of n sizes goes beyond with a probability of `FALSE_ALARM` / n.
    """
    sizes = sum(parameter.tells for effect in candidates for parameter in effect.parameters)
    return float(-ndtri(0.5 * FALSE_ALARM / max(sizes, 1)))


def insignificant(fit: Fit, spread: Array, names: Sequence[str], least: float) -> tuple[str, ...]:
    """Those of the named effects all of whose sizes that tell are within `least` errors of nothing.

    A road is told by its laps.

    Args:
        spread: (p, p) covariance that is stated of the parameters of `fit`.
    """
    blocks = {block.effect.name: block for block in fit.predictor.blocks}
    within = least * np.sqrt(np.diag(spread))
    return tuple(name for name in names if not _significant(fit, within, blocks[name]))


def _significant(fit: Fit, within: Array, block: Block) -> bool:
    rows, table = block.parameters, fit.predictor.table[block.parameters]
    beyond = np.abs(fit.parameters[rows] - np.array([p.prior for p in table])) > within[rows]
    return bool(block.effect.profile) or bool(np.any(beyond[[p.tells for p in table]]))
