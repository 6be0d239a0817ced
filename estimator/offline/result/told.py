"""Which of the effects of a fit the data tell from nothing, by the errors that are stated of their sizes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import ndtri

from estimator.model.effects.base import Effect
from estimator.offline.fit.prediction_error import Fit
from estimator.offline.predict.places import PLACES, Place, term_effect
from estimator.offline.predict.predict import Block
from estimator.offline.result.leftover import PLACED
from hil_gateway.process.arrays import Array

FALSE_ALARM = 0.05
"""Probability that of effects none of which is there one is told from nothing."""
DRIVEN = 0.01, 0.99
"""Quantiles of what a term is over a drive: beyond them are seconds."""


def least_errors(candidates: Sequence[Effect]) -> float:
    """Standard errors that every size of the `candidates` stays within, 1 - `FALSE_ALARM`, where none is there.

    The bound of Bonferroni: each of n sizes goes beyond with a probability of `FALSE_ALARM` / n.
    """
    sizes = sum(parameter.tells for effect in candidates for parameter in effect.parameters)
    return float(-ndtri(0.5 * FALSE_ALARM / max(sizes, 1)))


def untold(fit: Fit, others: Sequence[Array], spread: Array, names: Sequence[str], least: float) -> tuple[str, ...]:
    """Those of the named effects all of whose sizes that tell may be nothing, or of either sign.

    A size may be what the fit found, or what any of `others` (p,) says instead, within `least` errors. A road is told
    by its laps.

    Args:
        spread: (p, p) covariance of the parameters of `fit`, of any one of these.
    """
    blocks = {block.effect.name: block for block in fit.predictor.blocks}
    sizes, errors = np.stack([fit.parameters, *others]), np.sqrt(np.diag(spread))
    return tuple(name for name in names if not _told(fit, sizes, least * errors, blocks[name]))


def _told(fit: Fit, sizes: Array, within: Array, block: Block) -> bool:
    rows, table = block.parameters, fit.predictor.table[block.parameters]
    off = sizes[:, rows] - np.array([p.prior for p in table])
    beyond = np.all(off > within[rows], axis=0) | np.all(off < -within[rows], axis=0)
    return bool(block.effect.profile) or bool(np.any(beyond[[p.tells for p in table]]))


def taken_back(fit: Fit) -> Array:
    """(p,) parameters with each effect that a spline of one signal has the law of as small as both are together.

    The level of such a spline is a convention: a constant force beside one that takes it back wherever the drive pushes
    no more is as little a resistance as it is a drive. What is taken back at one place, or for some time, is something
    else there.
    """
    sizes = fit.parameters.copy()
    blocks = {block.effect.name: block for block in fit.predictor.blocks}
    for place_name, place in PLACES.items():
        constant = blocks.get(place.constant)
        for term in blocks.values():
            beside = term.effect.name == term_effect(place_name, term.effect.cause).name
            if constant is not None and beside and term.effect.cause not in PLACED:
                sizes[constant.parameters] += _smallest_change(fit, place, constant, term)
    return sizes


def _smallest_change(fit: Fit, place: Place, constant: Block, term: Block) -> float:
    """What leads from the size of a constant effect to the smallest that it is together with the term."""
    record, prior = fit.predictor.record, fit.predictor.table[constant.parameters][0].prior
    signal = record.signals[term.effect.profile][record.rows].ravel()
    values = record.bases[term.effect.profile].matrix(signal) @ fit.parameters[term.parameters]
    off = float(fit.parameters[constant.parameters][0]) - prior
    together = np.sort(off + place.constant_per_unit(record.vehicle) * np.quantile(values, DRIVEN))
    return float(np.clip(0.0, *together)) - off
