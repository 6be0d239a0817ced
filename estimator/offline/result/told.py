"""Which of the effects of a fit the data tell from nothing, by the errors that are stated of their sizes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import ndtri

from estimator.model.effects.base import Effect
from estimator.offline.fit.prediction_error import Fit
from estimator.offline.predict.predict import Block
from hil_gateway.process.arrays import Array

FALSE_ALARM = 0.05
"""Probability that of effects none of which is there one is told from nothing."""


def least_errors(candidates: Sequence[Effect]) -> float:
    """Standard errors that every size of the `candidates` stays within, 1 - `FALSE_ALARM`, where none is there.

    The bound of Bonferroni: each of n sizes goes beyond with a probability of `FALSE_ALARM` / n.
    """
    sizes = sum(parameter.tells for effect in candidates for parameter in effect.parameters)
    return float(-ndtri(0.5 * FALSE_ALARM / max(sizes, 1)))


def untold(fit: Fit, spread: Array, names: Sequence[str], least: float) -> tuple[str, ...]:
    """Those of the named effects all of whose sizes that tell are within `least` errors of nothing.

    A road is told by its laps.

    Args:
        spread: (p, p) covariance that is stated of the parameters of `fit`.
    """
    blocks = {block.effect.name: block for block in fit.predictor.blocks}
    within = least * np.sqrt(np.diag(spread))
    return tuple(name for name in names if not _told(fit, within, blocks[name]))


def _told(fit: Fit, within: Array, block: Block) -> bool:
    rows, table = block.parameters, fit.predictor.table[block.parameters]
    beyond = np.abs(fit.parameters[rows] - np.array([p.prior for p in table])) > within[rows]
    return bool(block.effect.profile) or bool(np.any(beyond[[p.tells for p in table]]))
