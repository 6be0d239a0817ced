"""The term of a stretch of other grip: fitted beside effects, its edges sought again around that fit.

Tyres that were fitted to the stretch as well hide its edges; those of the fit without it are not bent by it any more.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimator.model.basis import Proportional
from estimator.model.effect import Effect, Hook
from estimator.offline.fit.prediction_error import Fit, residual
from estimator.offline.predict.predict import Predictor
from estimator.offline.record.record import LATERAL_ROWS, Record
from estimator.offline.record.road import LEAST_LAPS
from estimator.offline.search.empirical import Term
from estimator.offline.search.evidence import SIGNIFICANCE, compare
from estimator.offline.search.stretches.cells import (
    FORMS,
    GRIP_STD,
    NOWHERE,
    Candidate,
    Stretch,
    around,
    effect_of,
)
from estimator.offline.search.trial import Setting, fit_names

AGAIN = 3
"""times that the edges are sought anew at most"""


@dataclass(frozen=True)
class StretchTerm(Term):
    """Another grip of both axles on a stretch; its signal is track position, its one coefficient the change.

    `known` are mean and deviation of the change before the fit.
    """

    hook: Hook = FORMS[0]
    stretch: Stretch = NOWHERE
    known: tuple[float, float] = (0.0, GRIP_STD)

    @classmethod
    def of(cls, found: Candidate, known: tuple[float, float] = (0.0, GRIP_STD)) -> StretchTerm:
        """The term before it is fitted."""
        stretch = found.stretch
        name = f"empirical_grip_from_{stretch.start:.0f}_to_{stretch.end:.0f}_m"
        nothing = compare(np.ones((5, 1)), np.ones((5, 1)), np.ones(1))
        return cls(name, "track_position", Proportional(name, 1), nothing, None, found.hook, stretch, known)

    @property
    def label(self) -> str:
        """What it is, in words."""
        return f"grip from {self.stretch.start:.0f} to {self.stretch.end:.0f} m"

    @property
    def effect(self) -> Effect:
        """The term as an effect."""
        return effect_of(self.place, self.hook, self.known)

    def added_to(self, setting: Setting) -> Setting:
        """The search with this term always active."""
        record = setting.record
        signals = {**record.signals, self.place: self.stretch.covers(record)}
        setting = replace(setting, record=replace(record, signals=signals))
        return setting.with_term(self.effect, self.basis, self.evidence.channels)

    def repeats(self, record: Record) -> bool:
        """Whether the stretch gains wherever it acts, beyond scatter, and in more than one lap.

        Where it does not act it cannot gain, so that the other stretches and the halves of the time say nothing.
        """
        acts = record.thin(self.stretch.covers(record)).any(axis=1)
        gains = self.evidence.laps[np.unique(record.lap[acts])]
        if len(np.unique(record.window_laps[acts])) < LEAST_LAPS or len(gains) < LEAST_LAPS:
            return False
        return bool(gains.mean() > SIGNIFICANCE * gains.std(ddof=1) / np.sqrt(len(gains)) or np.all(gains > 0))


def search_stretch(
    setting: Setting, accepted: Sequence[str], current: Fit, least: float, progress: Callable[[str], None]
) -> list[StretchTerm]:
    """The stretch that gains most, fitted; none below a gain of `least`, and none of a single lap."""
    found = localised(setting, accepted, current, least)
    if found is None or len(found[0].stretch.laps) < LEAST_LAPS:
        return []
    return [fitted(setting, accepted, current, found[0], progress)]


def fitted(
    setting: Setting, accepted: Sequence[str], current: Fit, found: Candidate, progress: Callable[[str], None]
) -> StretchTerm:
    """The term of a candidate, fitted together with all else."""
    term = StretchTerm.of(found)
    progress(term.label)
    fit = fit_names(term.added_to(setting), accepted, current)
    return replace(term, evidence=compare(current.held_out(), fit.held_out(), fit.normal.count), fit=fit)


def localised(setting: Setting, accepted: Sequence[str], current: Fit, least: float) -> tuple[Candidate, float] | None:
    """The candidate beside these effects, and the share that it holds of what they leave in the lateral channels.

    Tyres that were fitted to the stretch as well hide its edges: it is left out and sought again. None below a gain of
    `least`, or where no sensor tells.
    """
    if not can_tell(setting.record):
        return None
    whole = replace(current, predictor=Predictor(setting.model(accepted), setting.record))
    found = around(whole)
    for _ in range(AGAIN):
        if found.gain < least:
            return None
        elsewhere = replace(setting, record=without(setting.record, [found.stretch]))
        fit = fit_names(elsewhere, accepted, whole)
        whole, last = replace(fit, predictor=whole.predictor), found
        found = around(whole)
        if (found.stretch, found.hook) == (last.stretch, last.hook):
            break
    return found, share_of_excess(whole, found.stretch)


def can_tell(record: Record) -> bool:
    """Whether there are laps, places, and a sensor of the lateral motion."""
    return "track_position" in record.bases and bool(record.used[LATERAL_ROWS].any())


def share_of_excess(fit: Fit, stretch: Stretch) -> float:
    """Of the squares beyond noise that a fit leaves in the lateral channels, the part on the stretch."""
    record, rows = fit.predictor.record, LATERAL_ROWS
    squares = residual(fit.predictor, fit.parameters, fit.noise)[rows] ** 2
    weight = (record.used / fit.normal.variance)[rows]
    excess = np.einsum("cwb,c->wb", squares - fit.normal.floor[rows, None, None], weight)
    return float(excess[record.thin(stretch.covers(record)) > 0.0].sum() / max(float(excess.sum()), 1e-9))


def without(record: Record, stretches: Sequence[Stretch]) -> Record:
    """The record less the windows that have a part in one of the stretches."""
    inside = np.zeros(record.windows, bool)
    for stretch in stretches:
        inside |= record.thin(stretch.covers(record)).any(axis=1)
    elsewhere = record.select(~inside)
    _, group = np.unique(elsewhere.lap, return_inverse=True)
    return replace(elsewhere, lap=group.astype(np.int64))
