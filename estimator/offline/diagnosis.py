"""The whole chain on one record: split, search, empirical term, scores, verdict."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from estimator.model.basis import make_basis
from estimator.model.parameters import Layout
from estimator.model.single_track import SingleTrack
from estimator.offline.fit.prediction_error import Fit
from estimator.offline.record.record import Record
from estimator.offline.record.road import find_road
from estimator.offline.result.diagnosis_score import noise_floor, rmse, rollout
from estimator.offline.result.leftover import Leftover, leftovers
from estimator.offline.search.empirical import Term
from estimator.offline.search.evidence import Evidence
from estimator.offline.search.search import Search, search
from estimator.offline.search.terms import Outcome, Rival, with_terms
from estimator.offline.search.trial import Setting, Trial, fit_names
from estimator.offline.search.whiteness import structured, structured_elsewhere
from estimator.offline.search.workers import workers
from hil_gateway.process.arrays import Array, Ints

Progress = Callable[[str], None]

TEST_SHARE = 0.375
"""Share of the laps, the last ones, that no fit or choice sees: 3 of 8."""
WORSE = 1.2
"""A model whose error on the last laps exceeds the re-fitted one's by this factor is contradicted by them."""
EXPLAINED, WHITE_IN_LATE_LAPS = 2.0, 3.0
"""Where averages of the residual vary no more than so many times what white noise would on the laps learnt from, but
so much more on the last ones, these hold something new. Speeds never learnt at
reach 2 with the true effects; 5 is a residual with nothing but slow structure."""


@dataclass(frozen=True)
class Model:
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
        rollout: state -> those names -> RMS error after the horizon.
        leftover: channels in which the final model leaves more than noise.
        gains: evidence of each accepted effect given everything else; terms: accepted empirical terms.
    """

    record: Record
    train_laps: tuple[int, ...]
    test_laps: tuple[int, ...]
    test_rows: Ints
    search: Search
    fit: Fit
    accepted: tuple[str, ...]
    gains: Mapping[str, Evidence]
    terms: tuple[Term, ...]
    models: Mapping[str, Model]
    channels: Mapping[str, Mapping[str, float]]
    rollout: Mapping[str, Mapping[str, float]]
    term_trials: tuple[Term, ...]
    leftover: tuple[Leftover, ...]

    @property
    def verdict(self) -> str:
        """none | effect | unexplained; the first two only where no channel is left with more than noise."""
        if self.terms or self.leftover:
            return "unexplained"
        return "effect" if self.accepted else "none"


def split_laps(record: Record) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Laps to learn from and laps to be scored on; without laps every fourth block of time is for scoring."""
    laps = sorted({int(lap) for lap in record.lap})
    last = max(1, round(TEST_SHARE * len(laps)))
    test = tuple(laps[-last:] if record.has_laps else laps[3::4])
    return tuple(lap for lap in laps if lap not in test), test


def diagnose(
    record: Record,
    layout: Layout,
    prior: Mapping[str, float] | None,
    progress: Progress = lambda _: None,
    processes: int = 1,
) -> Diagnosis:
    """Find what the declared model lacks, with fits in so many `processes` at once.

    Where the laps learnt from are explained and yet the last laps hold more, which begins only there or late,
    laps in between are kept for scoring instead, so that it can be learnt at all.
    """
    train_laps, test_laps = split_laps(record)
    with workers(processes) as pool:
        setting = Setting(record, layout, prior, pool=pool)
        found = _diagnose(setting, (train_laps, test_laps), progress)
        if not _late_laps_differ(found):
            return found
        laps = (*train_laps, *test_laps)
        between = tuple(sorted(laps)[2::3])
        progress("once more: the last laps hold something that the others do not")
        return _diagnose(setting, (tuple(lap for lap in laps if lap not in between), between), progress)


def _late_laps_differ(found: Diagnosis) -> bool:
    """Whether what was learnt makes the last laps worse, or explains the others and leaves those unexplained."""
    if any(c["with_effects"] > WORSE * c["refit"] for c in found.channels.values()):
        return True
    late = found.record.select(np.isin(found.record.lap, found.test_laps))
    explained = not structured(found.fit, EXPLAINED)
    return explained and structured_elsewhere(found.fit, late, WHITE_IN_LATE_LAPS)


def _diagnose(whole: Setting, split: tuple[tuple[int, ...], tuple[int, ...]], progress: Progress) -> Diagnosis:
    """Diagnose the record of `whole` with given laps to learn from and to score on."""
    train_laps, test_laps = split
    record = _time_basis_of(whole.record, train_laps)
    train = record.select(np.isin(record.lap, train_laps))
    progress("road")
    train = replace(train, road=find_road(train))
    train = replace(train, lap=np.arange(train.windows, dtype=np.int64) // HELD_OUT_WINDOWS)
    setting = replace(whole, record=train)
    rival = Rival(setting, progress)
    found = search(setting, progress, enough=rival.outweighs)
    outcome = with_terms(setting, found, rival, progress)
    setting = outcome.setting
    record = replace(record, signals=setting.record.signals, bases=setting.record.bases)
    progress("scoring on the test laps")
    test_rows = np.sort(record.rows[np.isin(record.lap, test_laps)].ravel())
    models = _models(setting, outcome)
    scores = {name: rmse(record, test_rows, m.model, m.parameters) for name, m in models.items()}
    ahead = {name: rollout(record, test_rows, m.model, m.parameters) for name, m in models.items()}
    best = models["with_effects"]
    floor = noise_floor(record.select(np.isin(record.lap, test_laps)), test_rows, best.model, best.parameters)
    channels = {c: {name: s[c] for name, s in scores.items()} | {"noise_floor": floor[c]} for c in floor}
    states = {n: {name: a[n] for name, a in ahead.items()} for n in ahead["refit"]}
    return Diagnosis(
        record, train_laps, test_laps, test_rows, outcome.search, outcome.fit, outcome.accepted, outcome.gains,
        outcome.terms, models, channels, states, outcome.tried,
        leftovers(record, test_rows, best.model, best.parameters, floor),
    )  # fmt: skip


HELD_OUT_WINDOWS = 15
"""Stretches of so many windows (30 s) are held out in turn: shorter than a lap, so that what depends on time is
predicted from before and after, and long enough to be independent of each other."""


def _time_basis_of(record: Record, laps: tuple[int, ...]) -> Record:
    """The record with knots over time only where it is learnt from: beyond, a term in time stays what it was last."""
    learnt = record.signals["t"][record.rows[np.isin(record.lap, laps)]]
    return replace(record, bases={**record.bases, "t": make_basis("t", learnt, record.lap_length)})


def _models(setting: Setting, outcome: Outcome) -> dict[str, Model]:
    declared = SingleTrack(setting.record.vehicle, setting.layout, (), setting.prior)
    tyre = np.array([p.prior for p in declared.tyre_table])
    final, base = outcome.fit, outcome.search.base
    catalogue_fit = fit_names(replace(setting, extra=()), outcome.accepted, final) if outcome.terms else final
    return {
        "declared": Model(declared, tyre),
        "refit": Model(base.predictor.model, base.parameters),
        "catalogue": Model(catalogue_fit.predictor.model, catalogue_fit.parameters),
        "with_effects": Model(final.predictor.model, final.parameters),
    }


def alternatives(found: Search, name: str) -> list[Trial]:
    """What else was tried in the round in which `name` was accepted, best first."""
    for trials in found.rounds:
        if trials and any(t.name == name and t.fit for t in trials):
            return [t for t in trials if t.name != name]
    return []
