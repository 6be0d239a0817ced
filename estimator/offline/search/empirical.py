"""What no catalogue effect explains: an empirical term, a regularised spline of one signal acting in one place.

Places where it can act and signals it can depend on are tried against each other by the same held-out evidence
as the catalogue, from one linearisation; the knots of the best then move to where the spline changes. The term is a
model of the data, not of the physics, and is reported as such.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from estimator.model.basis import FEW_VALUES, Basis
from estimator.model.effects.base import Effect
from estimator.offline.fit.normal import Normal, accumulate
from estimator.offline.fit.prediction_error import Fit
from estimator.offline.predict.linearised import Linearised, linearised
from estimator.offline.predict.places import PLACES, term_effect
from estimator.offline.predict.predict import Predictor
from estimator.offline.record.record import Record
from estimator.offline.search.evidence import Evidence, compare
from estimator.offline.search.trial import Setting, warm_start
from estimator.offline.search.workers import Job, fit_each
from hil_gateway.process.arrays import Array

SIGNALS = (
    "vx", "ay", "yaw_rate", "vy", "steer", "steer_rate", "drive", "drive_rate", "track_position", "t", "yaw",
    "turn_direction", "throttle", "brake", "gear", "engine_speed", "z",
)  # fmt: skip
SCREENING_STRIDE = 4
"""Screening uses every fourth window."""
FITTED = 4
REFINED = 8
"""So many of the best terms have their knots moved in the screening; those that are fitted once more on all windows."""
COLUMNS_AT_ONCE = 160


@dataclass(frozen=True)
class Term:
    """An empirical term tried on top of a model."""

    place: str
    signal: str
    basis: Basis
    evidence: Evidence
    fit: Fit | None = None

    def added_to(self, setting: Setting) -> Setting:
        """The search with this term always active."""
        return setting.with_term(self.effect, self.basis, self.evidence.channels)

    @property
    def effect(self) -> Effect:
        """The term as an effect."""
        return term_effect(self.place, self.signal)


def search_terms(
    setting: Setting, accepted: Sequence[str], current: Fit, progress: Callable[[str], None]
) -> list[Term]:
    """Empirical terms by held-out evidence, best first; the most promising fitted to the end."""
    progress("anything else, by any signal")
    there = {effect.name for effect in setting.extra}
    screened = [t for t in _Screening.make(setting, accepted, current, True).terms() if t.effect.name not in there]
    whole = _Screening.make(setting, accepted, current, False)
    screened[:FITTED] = [whole.refined(term) for term in screened[:FITTED]]
    before, count = current.held_out(), current.normal.count
    best = screened[:FITTED]
    jobs = [Job(f"spline of {t.signal} in {t.place}", tuple(accepted), t.added_to(setting)) for t in best]
    fits = fit_each(setting, current, jobs, progress)
    done = [replace(t, evidence=compare(before, f.held_out(), count), fit=f) for t, f in zip(best, fits, strict=True)]
    return sorted(done, key=lambda t: -t.evidence.gain) + screened[FITTED:]


def explanatory(record: Record) -> list[str]:
    """Signals an empirical term may depend on: those the record has, and every extra column."""
    return [n for n in dict.fromkeys((*SIGNALS, *record.extra)) if n in record.bases]


@dataclass(frozen=True)
class _Screening:
    """One linearisation of a model and of a unit at every place.

    Attributes:
        predictor: of the model, on all windows or part of them; stride: of how many one is used; current: its fit.
        values, state_by, jacobian: predictions, derivatives by states and by the parameters of the model.
        units: (5, places, windows, blocks) derivatives by a unit at each of `PLACES`.
    """

    predictor: Predictor
    stride: int
    current: Fit
    values: Array
    state_by: Array
    jacobian: Array
    units: Array

    @classmethod
    def make(cls, setting: Setting, accepted: Sequence[str], current: Fit, thinned: bool) -> _Screening:
        """Linearise at the current fit."""
        stride = SCREENING_STRIDE if thinned else 1
        chosen = np.arange(setting.record.windows) % stride == 0
        if np.unique(setting.record.lap[chosen]).size != np.unique(setting.record.lap).size:
            chosen[:], stride = True, 1
        record = current.predictor.record.select(chosen)
        model = setting.model(accepted)
        points = tuple(replace(term_effect(place, "t"), profile="", name=place) for place in PLACES)
        wide = Predictor(replace(model, effects=(*model.effects, *points)), record)
        start = warm_start(wide, wide.start([p.prior for p in model.tyre_table]), current)
        values, state_by, jacobian = wide.linearise(start)
        size = len(current.parameters)
        return cls(Predictor(model, record), stride, current, values, state_by, jacobian[:, :size], jacobian[:, size:])

    def terms(self) -> list[Term]:
        """Predicted evidence of every place and signal, best first; the best with moved knots."""
        record, before = self.predictor.record, self._before
        found = []
        for signal in explanatory(record):
            basis = record.bases[signal]
            for places in _groups(basis.size):
                columns = self._columns(places, basis)
                for place, own in zip(places, np.split(columns, len(places), axis=1), strict=True):
                    evidence, _ = self._evidence(self._with(place, basis, own), before)
                    found.append(Term(place, signal, basis, evidence))
        found.sort(key=lambda t: -t.evidence.gain)
        found[:REFINED] = [self.refined(term) for term in found[:REFINED]]
        return sorted(found, key=lambda t: -t.evidence.gain)

    @cached_property
    def _model(self) -> Linearised:
        """The model alone."""
        return linearised(self.predictor.record, self.values, self.state_by, self.jacobian, self.current.noise)

    @cached_property
    def _before(self) -> Array:
        """(5, laps) held-out squares of the model alone."""
        normal = self._accumulated(self._model.sensitivity, self.current.normal.prior)
        return normal.held_out(self.current.normal.variance)

    def refined(self, term: Term) -> Term:
        """The term with its knots where it changes, if that gains."""
        basis, before = term.basis, self._before
        if len(basis.knots) and basis.size <= FEW_VALUES:
            return term
        record = self.predictor.record
        evidence, coefficients = self._evidence(self._normal(term.place, basis), before)
        term = replace(term, evidence=evidence)
        driven = record.signals[term.signal][record.rows].ravel()
        basis = basis.moved(coefficients[-basis.size :], driven)
        evidence, _ = self._evidence(self._normal(term.place, basis), before)
        return replace(term, basis=basis, evidence=evidence) if evidence.gain > term.evidence.gain else term

    def _evidence(self, normal: Normal, before: Array) -> tuple[Evidence, Array]:
        """Predicted evidence over the model alone, and the step of all parameters."""
        variance = self.current.normal.variance
        after = normal.held_out(variance)
        return compare(before, after, normal.count * self.stride), normal.step(variance)

    def _columns(self, places: Sequence[str], basis: Basis) -> Array:
        """(5, places * coefficients, windows, blocks) sensitivity by one signal's term at each of `places`."""
        record, shape = self.predictor.record, self.values.shape[1:]
        matrix = basis.matrix(record.thin(record.signals[basis.signal]).ravel())
        units = self.units[:, [list(PLACES).index(p) for p in places]].reshape(5, len(places), 1, -1)
        return self._model.sensitivity_by((units * matrix.T).reshape(5, -1, *shape))

    def _normal(self, place: str, basis: Basis) -> Normal:
        """Normal equations of the model and a term."""
        return self._with(place, basis, self._columns((place,), basis))

    def _with(self, place: str, basis: Basis, own: Array) -> Normal:
        """The same from the sensitivity (5, coefficients, windows, blocks) by the term."""
        size = len(self.current.parameters)
        prior = np.zeros((size + basis.size,) * 2)
        prior[:size, :size], prior[size:, size:] = self.current.normal.prior, basis.precision(PLACES[place].std)
        return self._accumulated(np.concatenate([self._model.sensitivity, own], axis=1), prior)

    def _accumulated(self, sensitivity: Array, prior: Array) -> Normal:
        record, size = self.predictor.record, len(self.current.parameters)
        laps = int(record.lap.max()) + 1
        count = np.array([np.count_nonzero(record.lap == lap) for lap in range(laps)]) * float(record.rows.shape[1])
        pull = np.zeros(len(prior))
        pull[:size] = -self.current.normal.prior @ (self.current.parameters - self.predictor.prior)
        sums = accumulate(self._model.error, sensitivity, record.lap)
        return Normal(*sums, count, prior, pull, record.block_noise**2)


def _groups(size: int) -> list[tuple[str, ...]]:
    """Places handled in one go, so that no more than about `COLUMNS_AT_ONCE` sensitivities are held at once."""
    names, most = tuple(PLACES), max(1, COLUMNS_AT_ONCE // size)
    return [names[i : i + most] for i in range(0, len(names), most)]
