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
from estimator.model.declared_vehicle import all_candidates
from estimator.model.effect import Effect
from estimator.offline.fit.normal import TINY, Normal, accumulate
from estimator.offline.fit.prediction_error import Fit, residual_counts
from estimator.offline.predict.linearised import Linearised, linearised
from estimator.offline.predict.places import PLACES, term_effect
from estimator.offline.predict.predict import Predictor
from estimator.offline.record.record import Record
from estimator.offline.record.window_columns import WindowBasis, WindowColumns
from estimator.offline.search.evidence import Evidence, compare
from estimator.offline.search.trial import Setting, warm_start
from estimator.offline.search.workers import FitJob, fit_each
from hil_gateway.process.arrays import Array

SIGNALS = (
    "vx", "ay", "yaw_rate", "vy", "steer", "steer_rate", "drive", "drive_rate", "track_position", "t", "yaw",
    "turn_direction", "throttle", "brake", "gear", "engine_speed", "z",
)  # fmt: skip
SCREENING_STRIDE = 4
"""Screening uses every fourth window, where these tell what is left in all of them."""
REPRESENTED = 0.3
"""Relative standard deviation of a sum of squares over every fourth window, as if these were drawn at random, up to
which they do: what is left at one place of the lap, for a window or two, is in few of them or in none."""
FITTED = 4
REFINED = 8
"""So many of the best terms have their knots moved in the screening; those that are fitted once more on all windows."""


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
    def label(self) -> str:
        """What it is, in words."""
        return f"spline of {self.signal} in {self.place}"

    def repeats(self, record: Record) -> bool:
        """Whether it gains over the stretches of the `record` beyond scatter, and in either half of the time."""
        return self.evidence.consistent

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
    screened = [t for t in Screening.make(setting, accepted, current, True).terms() if t.effect.name not in there]
    whole = Screening.make(setting, accepted, current, False)
    screened[:FITTED] = [whole.levelled(whole.refined(term), accepted) for term in screened[:FITTED]]
    before, count = current.held_out(), current.normal.count
    best = screened[:FITTED]
    jobs = [FitJob(t.label, tuple(accepted), t.added_to(setting)) for t in best]
    fits = fit_each(setting, current, jobs, progress)
    done = [replace(t, evidence=compare(before, f.held_out(), count), fit=f) for t, f in zip(best, fits, strict=True)]
    return sorted(done, key=lambda t: -t.evidence.gain) + screened[FITTED:]


def explanatory(record: Record) -> list[str]:
    """Signals an empirical term may depend on: those the record has, and every extra column."""
    return [n for n in dict.fromkeys((*SIGNALS, *record.extra)) if n in record.bases]


def represented(squares: Array, stride: int) -> bool:
    """Whether every so many windows tell what is left in all of them; `squares` (5, windows) of what is left."""
    windows = squares.shape[1]
    error = np.sqrt((stride - 1) / windows) * squares.std(axis=1) / np.maximum(squares.mean(axis=1), TINY)
    return bool(np.all(error < REPRESENTED))


@dataclass(frozen=True)
class Screening:
    """One linearisation of a model and of a unit at every place.

    Attributes:
        predictor: of the model, on all windows or part of them; stride: of how many one is used; current: its fit.
        left: residual of the model; sensitivity: by its parameters.
        units: (blocks, windows, 5, places) derivatives by a unit at each of `PLACES`.
    """

    predictor: Predictor
    stride: int
    current: Fit
    left: Linearised
    sensitivity: WindowColumns
    units: Array

    @classmethod
    def make(cls, setting: Setting, accepted: Sequence[str], current: Fit, thinned: bool) -> Screening:
        """Linearise at the current fit."""
        stride = SCREENING_STRIDE if thinned and represented(current.squares, SCREENING_STRIDE) else 1
        chosen = np.arange(setting.record.windows) % stride == 0
        if np.unique(setting.record.lap[chosen]).size != np.unique(setting.record.lap).size:
            chosen[:], stride = True, 1
        record = current.predictor.record.select(chosen)
        model = setting.model(accepted)
        points = tuple(replace(term_effect(place, "t"), profile="", name=place) for place in PLACES)
        wide = Predictor(replace(model, effects=(*model.effects, *points)), record)
        start = warm_start(wide, wide.start([p.prior for p in model.tyre_table]), current)
        values, state_by, columns = wide.linearise(start)
        left = linearised(record, values, state_by, current.noise)
        own, units = columns.split(len(current.parameters))
        return cls(Predictor(model, record), stride, current, left, left.sensitivity(own), units.values)

    def terms(self) -> list[Term]:
        """Predicted evidence of every place and signal, best first; the best with moved knots."""
        record = self.predictor.record
        found = []
        for signal in explanatory(record):
            basis = record.bases[signal]
            for place, own in zip(PLACES, self._columns(tuple(PLACES), basis), strict=True):
                evidence, _ = self._evidence(self._with(place, basis, own))
                found.append(Term(place, signal, basis, evidence))
        found.sort(key=lambda t: -t.evidence.gain)
        found[:REFINED] = [self.refined(term) for term in found[:REFINED]]
        return sorted(found, key=lambda t: -t.evidence.gain)

    @cached_property
    def _before(self) -> Array:
        """(5, laps) held-out squares of the model alone."""
        normal = self._accumulated(self.sensitivity, self.current.normal.prior)
        return normal.held_out(self.current.normal.variance)

    def refined(self, term: Term) -> Term:
        """The term with its knots where it changes, if that gains."""
        basis = term.basis
        if len(basis.knots) and basis.size <= FEW_VALUES:
            return term
        record = self.predictor.record
        evidence, coefficients = self._evidence(self._normal(term.place, basis))
        term = replace(term, evidence=evidence)
        driven = record.signals[term.signal][record.rows].ravel()
        basis = basis.moved(coefficients[-basis.size :], driven)
        evidence, _ = self._evidence(self._normal(term.place, basis))
        return replace(term, basis=basis, evidence=evidence) if evidence.gain > term.evidence.gain else term

    def levelled(self, term: Term, accepted: Sequence[str]) -> Term:
        """The term without a constant, where an accepted effect has it: its size would be no size of that effect."""
        if not any(all_candidates()[name].constant_at == term.place for name in accepted):
            return term
        record = self.predictor.record
        does = np.sum(self.units[..., list(PLACES).index(term.place)] ** 2, axis=2).T.ravel()
        rows = term.basis.matrix(record.thin(record.signals[term.signal]).ravel())
        return replace(term, basis=replace(term.basis, level=tuple((does @ rows / does.sum()).tolist())))

    def _evidence(self, normal: Normal) -> tuple[Evidence, Array]:
        """Predicted evidence over the model alone, and the step of all parameters."""
        variance = self.current.normal.variance
        after = normal.held_out(variance)
        return compare(self._before, after, normal.count * self.stride), normal.step(variance)

    def _columns(self, places: Sequence[str], basis: Basis) -> list[WindowColumns]:
        """Sensitivity by one signal's term at each of `places`."""
        record = self.predictor.record
        matrix = basis.matrix(record.thin(record.signals[basis.signal]).ravel())
        windowed = WindowBasis.of(matrix, record.windows)
        chosen = [list(PLACES).index(place) for place in places]
        return [self.left.sensitivity(windowed.times(self.units[..., i])) for i in chosen]

    def _normal(self, place: str, basis: Basis) -> Normal:
        """Normal equations of the model and a term."""
        (own,) = self._columns((place,), basis)
        return self._with(place, basis, own)

    def _with(self, place: str, basis: Basis, own: WindowColumns) -> Normal:
        """The same from the sensitivity by the term."""
        size = len(self.current.parameters)
        prior = np.zeros((size + basis.size,) * 2)
        prior[:size, :size], prior[size:, size:] = self.current.normal.prior, basis.precision(PLACES[place].std)
        return self._accumulated(self.sensitivity.joined_with(own), prior)

    def _accumulated(self, sensitivity: WindowColumns, prior: Array) -> Normal:
        record, size = self.predictor.record, len(self.current.parameters)
        pull = np.zeros(len(prior))
        pull[:size] = -self.current.normal.prior @ (self.current.parameters - self.predictor.prior)
        sums = accumulate(self.left.error, sensitivity, record.lap)
        return Normal(*sums, residual_counts(record), prior, pull, record.block_noise**2)
