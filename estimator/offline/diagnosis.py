"""The whole chain on one record: split, search, empirical term, scores, verdict."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from estimator.model.declared_vehicle import id_of
from estimator.model.parameters import Layout
from estimator.model.single_track import SingleTrack
from estimator.offline.fit.prediction_error import Fit
from estimator.offline.predict.lateral_velocity import with_predicted_vy
from estimator.offline.predict.predict import Predictor
from estimator.offline.record.derivative import stretches
from estimator.offline.record.laps import scored_laps
from estimator.offline.record.map_road import road_effects
from estimator.offline.record.record import Record
from estimator.offline.record.road import find_road
from estimator.offline.result.diagnosis_score import (
    HORIZON_S,
    LONG_HORIZON_S,
    ROLLOUT_STATES,
    noise_floor,
    rmse,
    rollout,
)
from estimator.offline.result.lap_time import lap_times
from estimator.offline.result.leftover import Leftover, leftovers
from estimator.offline.result.uncertainty import covariance, critical_errors, insignificant
from estimator.offline.search.empirical import Term
from estimator.offline.search.evidence import Evidence
from estimator.offline.search.look_alike_term import LookAlikeTerm
from estimator.offline.search.pool import Pool, keep_freed_memory
from estimator.offline.search.screening import candidates
from estimator.offline.search.search import Search, search
from estimator.offline.search.stretches.cells import Candidate, most_gaining
from estimator.offline.search.stretches.term import StretchTerm, can_tell
from estimator.offline.search.terms import TERM_SHARE, Explanation, Rival, with_terms
from estimator.offline.search.trial import Setting, Trial, fit_names, never
from hil_gateway.process.arrays import Array, Ints

Progress = Callable[[str], None]


@dataclass(frozen=True)
class FittedModel:
    """A model with its numbers."""

    model: SingleTrack
    parameters: Array


@dataclass(frozen=True)
class Diagnosis:
    """Everything a result or a report needs.

    Attributes:
        record: the whole log; train_laps, test_laps: lap numbers of the split.
        models: "declared", "refit", "catalogue", "with_effects" -> model and parameters.
        channels: channel -> those names -> RMSE on the test laps; plus "noise_floor".
        rollout, long_rollout: state -> those names -> RMS error after `HORIZON_S` and `LONG_HORIZON_S`.
        lap_times: "driven" and those names -> s of a quasi-steady lap; empty without a whole scored lap.
        without_splines: `fit` without the empirical terms that are functions of one signal; itself where it has none.
        leftover: channels in which the final model leaves more than noise.
        gains: evidence of each accepted effect given everything else; terms: accepted empirical terms.
    """

    record: Record
    train_laps: tuple[int, ...]
    test_laps: tuple[int, ...]
    test_rows: Ints
    search: Search
    fit: Fit
    without_splines: Fit
    accepted: tuple[str, ...]
    gains: Mapping[str, Evidence]
    terms: tuple[Term, ...]
    models: Mapping[str, FittedModel]
    channels: Mapping[str, Mapping[str, float]]
    rollout: Mapping[str, Mapping[str, float]]
    long_rollout: Mapping[str, Mapping[str, float]]
    lap_times: Mapping[str, float]
    term_trials: tuple[Term, ...]
    leftover: tuple[Leftover, ...]
    cut_short: bool
    """whether the search ended because its time was over"""

    @cached_property
    def spread(self) -> Array:
        """(p, p) covariance that is stated of the parameters of `fit`."""
        return covariance(self.fit, self.without_splines)

    @cached_property
    def insignificant(self) -> tuple[str, ...]:
        """Accepted effects whose size is not told from nothing: they predict, and may stand in for another cause."""
        possible = candidates(self.fit.predictor.record, self.accepted)
        tried = [b.effect for b in self.fit.predictor.blocks if b.effect.name in self.accepted] + possible
        return insignificant(self.fit, self.spread, self.accepted, critical_errors(tried))

    @property
    def named(self) -> tuple[str, ...]:
        """Accepted effects that are told from nothing."""
        return tuple(name for name in self.accepted if name not in self.insignificant)

    @property
    def verdict(self) -> str:
        """none | effect | unexplained; the first two only where no channel is left with more than noise and every
        effect of the model is told from nothing."""
        if self.terms or self.leftover or self.insignificant:
            return "unexplained"
        return "effect" if self.accepted else "none"


def diagnose(
    record: Record,
    layout: Layout,
    prior: Mapping[str, float],
    progress: Progress = lambda _: None,
    pool: Pool | None = None,
    *,
    over: Callable[[], bool] = never,
) -> Diagnosis:
    """Find what the declared model lacks, with fits in the processes of a `pool` (`workers`), until it is `over`.

    A road that the record already has is a map's (`record_on_map`): always fitted, and no finding.
    """
    mapped = road_effects() if record.road else ()
    keep_freed_memory()
    return _diagnose(Setting(record, layout, prior, pool=pool, active=mapped, over=over), progress)


def _diagnose(whole: Setting, progress: Progress) -> Diagnosis:
    record = whole.record
    test_laps = scored_laps(record.lap, record.has_laps)
    train_laps = tuple(lap for lap in np.unique(record.lap).tolist() if lap not in test_laps)
    train = record.select(np.isin(record.lap, train_laps))
    progress("road")
    train = replace(train, road=train.road or find_road(train))
    train = replace(train, lap=held_out_in_turn(train.windows))
    setting = replace(whole, record=train)
    rival = Rival(setting, progress)
    found = search(setting, progress, enough=rival.outweighs)
    outcome = with_terms(setting, found, rival, progress)
    setting, cut_short = outcome.setting, whole.over()
    progress("last steps of the fit")
    outcome = replace(outcome, fit=fit_names(setting, outcome.accepted, outcome.fit, exact=True))
    record = replace(record, signals=setting.record.signals, bases=setting.record.bases)
    progress("scoring on the test laps")
    test_rows = np.sort(record.rows[np.isin(record.lap, test_laps)].ravel())
    catalogue = _without(setting, outcome, outcome.terms)
    models = _models(setting, outcome, catalogue)
    best = models["with_effects"]
    driven = stretches(np.sort(record.rows.ravel()), record.step, record.kernel_s)
    record = with_predicted_vy(record, driven, best.model, best.parameters, outcome.fit.noise)
    scores = {name: rmse(record, test_rows, m.model, m.parameters) for name, m in models.items()}
    ahead, far_ahead = (_ahead(record, test_rows, models, s) for s in (HORIZON_S, LONG_HORIZON_S))
    times = lap_times(record, test_rows, {name: (m.model, m.parameters) for name, m in models.items()})
    floor = noise_floor(record.select(np.isin(record.lap, test_laps)), test_rows, best.model, best.parameters)
    channels = {c: {name: s[c] for name, s in scores.items()} | {"noise_floor": floor[c]} for c in floor}
    splines = tuple(term for term in outcome.terms if not isinstance(term, StretchTerm | LookAlikeTerm))
    left = catalogue if splines == outcome.terms else _without(setting, outcome, splines)
    return Diagnosis(
        record, train_laps, test_laps, test_rows, outcome.search, outcome.fit, left, outcome.accepted,
        outcome.gains, outcome.terms, models, channels, ahead, far_ahead, times, outcome.tried,
        leftovers(record, test_rows, best.model, best.parameters, floor, _other_grip(record, outcome.fit)), cut_short,
    )  # fmt: skip


def _ahead(
    record: Record, rows: Ints, models: Mapping[str, FittedModel], horizon_s: float
) -> dict[str, dict[str, float]]:
    """State -> model -> RMS error after `horizon_s`."""
    errors = {name: rollout(record, rows, m.model, m.parameters, horizon_s) for name, m in models.items()}
    return {state: {name: e[state] for name, e in errors.items()} for state in ROLLOUT_STATES}


def _other_grip(record: Record, fit: Fit) -> Candidate | None:
    """A stretch of any laps, also scored ones, that another grip would explain; what is found is said, not learnt."""
    if not can_tell(record):
        return None
    whole = Predictor(fit.predictor.model, record)
    found = most_gaining(whole, fit.parameters, fit.noise, fit.normal.variance)
    over_time = found.longest and not found.stretch.every_lap
    return found if found.gain > TERM_SHARE * record.rows[:, :, 0].size and not over_time else None


HELD_OUT_WINDOWS = 15
"""Stretches of so many windows (30 s) are held out in turn: shorter than a lap, so that what depends on time is
predicted from before and after, and long enough to be independent of each other. A short log has few: in stretches of
7 s the errors depend on each other, and what they share passes for an effect."""


def held_out_in_turn(windows: int) -> Ints:
    """(windows,) number of the stretch that each window of the laps learnt from belongs to."""
    return np.arange(windows, dtype=np.int64) // HELD_OUT_WINDOWS


def _without(setting: Setting, outcome: Explanation, terms: Sequence[Term]) -> Fit:
    """The fit without these empirical `terms`."""
    if not terms:
        return outcome.fit
    names = {term.effect.name for term in terms}
    kept = tuple(effect for effect in setting.extra if effect.name not in names)
    return fit_names(replace(setting, extra=kept), outcome.accepted, outcome.fit, exact=True)


def _models(setting: Setting, outcome: Explanation, catalogue: Fit) -> dict[str, FittedModel]:
    declared = SingleTrack(setting.record.vehicle, setting.prior)
    tyre = np.array([p.prior for p in declared.tyre_table])
    final = outcome.fit
    base = fit_names(replace(setting, extra=()), (), outcome.search.base, exact=True)
    return {
        "declared": FittedModel(declared, tyre),
        "refit": FittedModel(base.predictor.model, base.parameters),
        "catalogue": FittedModel(catalogue.predictor.model, catalogue.parameters),
        "with_effects": FittedModel(final.predictor.model, final.parameters),
    }


def alternatives(found: Search, name: str) -> list[Trial]:
    """What else than another form of it was tried in the round in which `name` was accepted, best first."""
    for trials in found.rounds:
        if trials and any(t.name == name and t.fit for t in trials):
            return [t for t in trials if id_of(t.name) != id_of(name)]
    return []
