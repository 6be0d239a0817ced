"""One fit of the search: which effects, on what record, and what it gained."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.diagnose.evidence import Evidence
from estimator.diagnose.fit import MAX_ITERATIONS, Fit, fit
from estimator.diagnose.noise import MOTION_ROWS, Noise
from estimator.diagnose.predict import Predictor
from estimator.diagnose.record import Record
from estimator.diagnose.timing import sampling_effects
from estimator.model.effects import catalogue
from estimator.model.effects.base import Effect
from estimator.model.parameters import Layout
from estimator.model.single_track import SingleTrack

Array = NDArray[np.float64]

REWEIGHINGS, REWEIGH_ABOVE = 3, 0.1
"""A fit is repeated with its own residual deviations until these change by less than a tenth."""
FIRST_DRIFT = 1.0
"""of the motion, before anything is fitted: the model is trusted little"""
UNFITTED_SHARE = 0.02
"""Part of a signal that any model is taken to leave before anything is fitted."""


@dataclass(frozen=True)
class Setting:
    """What stays the same during a search; `extra` are effects always active (empirical terms)."""

    record: Record
    layout: Layout
    prior: Mapping[str, float] | None
    extra: tuple[Effect, ...] = ()
    pool: Executor | None = None
    """processes that fits are done in"""

    def model(self, names: Sequence[str]) -> SingleTrack:
        """The model with the named effects."""
        effects = tuple(e for e in catalogue().values() if e.name in names)
        sampling = sampling_effects(self.record.step, frozenset(names))
        return SingleTrack(self.record.vehicle, self.layout, effects + self.extra + sampling, self.prior)


@dataclass(frozen=True)
class Trial:
    """One candidate tried on top of what was accepted; `fit` only where it was fitted to the end."""

    name: str
    evidence: Evidence
    fit: Fit | None = None


def fit_names(setting: Setting, names: Sequence[str], warm: Fit | None, iterations: int | None = None) -> Fit:
    """Fit the model with the named effects, starting from what `warm` found."""
    model = setting.model(names)
    predictor = Predictor(model, setting.record)
    start = predictor.start([p.prior for p in model.tyre_table])
    if warm is not None:
        start = warm_start(predictor, start, warm)
    noise = _first_noise(setting.record) if warm is None else warm.noise
    done = fit(predictor, start, noise, iterations or MAX_ITERATIONS)
    for _ in range(0 if iterations else REWEIGHINGS):
        found = done.new_noise()
        if found.close_to(noise, REWEIGH_ABOVE):
            break
        noise = found
        done = fit(done.predictor, done.parameters, noise)
    return done


def _first_noise(record: Record) -> Noise:
    """Weights before anything is fitted: the sensors' noise, but no less than any model leaves of a measured signal."""
    spread = record.measured[:, record.rows.ravel()].std(axis=1)
    deviation = np.maximum(record.block_noise, UNFITTED_SHARE * spread)
    drift = np.zeros(len(spread))
    drift[list(MOTION_ROWS)] = FIRST_DRIFT
    return Noise(deviation, drift)


def warm_start(predictor: Predictor, start: Array, warm: Fit) -> Array:
    """`start` with tyre parameters and effects replaced by those `warm` already has."""
    size = len(predictor.model.tyre_table)
    start[:size] = warm.parameters[:size]
    known = {b.effect.name: warm.parameters[b.parameters] for b in warm.predictor.blocks}
    for block in predictor.blocks:
        if block.effect.name in known:
            start[block.parameters] = known[block.effect.name]
    return start
