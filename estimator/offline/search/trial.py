"""One fit of the search: which effects, on what record, and what it gained."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimator.model.basis import Basis
from estimator.model.declared_vehicle import all_candidates
from estimator.model.effect import Effect
from estimator.model.parameters import Layout
from estimator.model.single_track import CHANNELS, SingleTrack
from estimator.offline.fit.prediction_error import CONVERGED, MAX_ITERATIONS, Fit, fit
from estimator.offline.predict.predict import Predictor
from estimator.offline.record.noise import ResidualNoise
from estimator.offline.record.record import STATE_ROWS, Record
from estimator.offline.record.road_load import road_load
from estimator.offline.record.unknown_inputs import pedal_effects, sampling_effects, vy_effects
from estimator.offline.search.evidence import Evidence
from estimator.offline.search.pool import Pool
from hil_gateway.process.arrays import Array

REWEIGHINGS = 1
"""A fit goes on so many times with its own residual deviations; the next fit starts from what it found, so that a
search adapts them further."""
COMPARED = 8e-4
"""Fall of the deviance per block at which a fit that is only compared with others ends: 2 % of the least gain that
counts (`acceptance.SMALLEST_SHARE`)."""
FIRST_DRIFT = 1.0
"""of the motion, before anything is fitted: the model is trusted little"""
UNFITTED_SHARE = 0.02
"""Part of a signal that any model is taken to leave before anything is fitted."""
PROXY_SHARE = 0.1
"""An effect beside an empirical term must gain this share of what the term gains in the channel it gains most in."""


def never() -> bool:
    """No end in time."""
    return False


@dataclass(frozen=True)
class Setting:
    """What stays the same during a search.

    `extra` are effects always active (empirical terms). What is named beside them must gain, in the channel where it
    gains most, at least what `least` (5,) says: less is the imperfect shape of the term.
    """

    record: Record
    layout: Layout
    prior: Mapping[str, float]
    extra: tuple[Effect, ...] = ()
    least: tuple[float, ...] = (0.0,) * 5
    pool: Pool | None = None
    """processes that fits are done in"""
    active: tuple[Effect, ...] = ()
    """effects of the model in force, always fitted, with its values as their prior"""
    tyre_std: Mapping[str, float] | None = None
    """as in `SingleTrack`"""
    untried: frozenset[str] = frozenset()
    """candidates that the model is not to have"""
    over: Callable[[], bool] = never
    """whether the time for searching is over: what was found until then is the result"""

    def with_term(self, effect: Effect, basis: Basis, gained: Array) -> Setting:
        """The same with an empirical term always active that `gained` (5,); its basis stored under its own name."""
        record = self.record
        signals = {**record.signals, effect.profile: record.signals[basis.signal]}
        record = replace(record, signals=signals, bases={**record.bases, effect.profile: basis})
        least = tuple(float(g) for g in np.maximum(self.least, PROXY_SHARE * gained))
        return replace(self, record=record, extra=(*self.extra, effect), least=least)

    def model(self, names: Sequence[str]) -> SingleTrack:
        """The model with the named effects."""
        effects = tuple(e.of_size(self.record.vehicle) for e in all_candidates().values() if e.name in names)
        there = frozenset(names) | self.active_names
        sampling = sampling_effects(self.record.step, there)
        logged = pedal_effects(self.record.pedals) + vy_effects(self.record.vy_displaced)
        always = self.extra + sampling + logged + road_load(there, self.record.signals)
        return SingleTrack(self.record.vehicle, self.prior, self.active + effects + always, self.tyre_std)

    @property
    def found_road(self) -> tuple[str, ...]:
        """Bank and grade that the laps show and no map declares, by name."""
        return tuple(sorted(set(self.record.road) - self.active_names))

    @property
    def measured_road(self) -> tuple[str, ...]:
        """Found road that only a sensor of its own shows: no channel of the fit that it acts on is used."""
        return tuple(name for name in self.found_road if not self._judged(all_candidates()[name]))

    def _judged(self, effect: Effect) -> bool:
        """Whether the fit uses a channel that shows an effect."""
        rows = [CHANNELS.index(channel) for channel in effect.judged_by or effect.channels]
        return bool(self.record.used[rows].any())

    @property
    def active_names(self) -> frozenset[str]:
        """Names of what is always fitted."""
        return frozenset(effect.name for effect in self.active)


@dataclass(frozen=True)
class Trial:
    """One candidate tried on top of what was accepted; `fit` only where it was fitted to the end."""

    name: str
    evidence: Evidence
    fit: Fit | None = None


def fit_names(
    setting: Setting, names: Sequence[str], warm: Fit | None, iterations: int | None = None, exact: bool = False
) -> Fit:
    """Fit the model with the named effects, starting from what `warm` found; `exact` for what is reported."""
    model = setting.model(names)
    predictor = Predictor(model, setting.record)
    start = predictor.start([p.prior for p in model.tyre_table])
    if warm is not None:
        start = warm_start(predictor, start, warm)
    noise = _first_noise(setting.record) if warm is None else warm.noise
    blocks = setting.record.rows.shape[0] * setting.record.rows.shape[1]
    least = CONVERGED[0] if exact else max(CONVERGED[0], COMPARED * blocks)
    most, again = (MAX_ITERATIONS, REWEIGHINGS) if iterations is None else (iterations, 0)
    return fit(predictor, start, noise, most, least=least, reweighings=again)


def _first_noise(record: Record) -> ResidualNoise:
    """Weights before anything is fitted: the sensors' noise, but no less than any model leaves of a measured signal."""
    spread = record.measured[:, record.rows.ravel()].std(axis=1)
    deviation = np.maximum(record.block_noise, UNFITTED_SHARE * spread)
    drift = np.zeros(len(spread))
    drift[STATE_ROWS] = FIRST_DRIFT
    return ResidualNoise(deviation, drift)


def warm_start(predictor: Predictor, start: Array, warm: Fit) -> Array:
    """`start` with tyre parameters and effects replaced by those `warm` already has."""
    size = len(predictor.model.tyre_table)
    start[:size] = warm.parameters[:size]
    known = {b.effect.name: warm.parameters[b.parameters] for b in warm.predictor.blocks}
    for block in predictor.blocks:
        if block.effect.name in known:
            start[block.parameters] = known[block.effect.name]
    return start
