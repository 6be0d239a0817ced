"""Empirical terms beside, or instead of, what the catalogue explains.

An effect of the catalogue can earn its place only because it stands in for something the catalogue does not have. Two
explanations compete therefore where structure remains: the effects found, with an empirical term for what they leave,
and one empirical term on the declared model. Where the one term alone explains the session to its noise and more than
all the effects do, or far more than they, nothing is named but what still earns its place beside it.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

from estimator.offline.fit.prediction_error import Fit
from estimator.offline.predict.predict import Predictor
from estimator.offline.record.record import Record
from estimator.offline.record.road import LEAST_LAPS
from estimator.offline.search.acceptance import NOT_WHITE, earns_its_place, structured
from estimator.offline.search.empirical import Term, search_terms
from estimator.offline.search.evidence import Evidence, compare
from estimator.offline.search.greedy import Checked, check_each, recheck
from estimator.offline.search.look_alike_term import split_look_alikes
from estimator.offline.search.plausible import believed
from estimator.offline.search.search import Search, search, without_proxies
from estimator.offline.search.stretches.cells import MOST, around
from estimator.offline.search.stretches.term import StretchTerm, fitted, localised, search_stretch, without
from estimator.offline.search.trial import Setting, fit_names

Progress = Callable[[str], None]

TERM_SHARE = 0.05
"""Least gain per block for an empirical term: it has more freedom than an effect, so it has to gain more."""
TERM_RELATIVE = 0.03
"""Least gain of an empirical term relative to what the accepted effects gained: less is their imperfect shape."""
MAX_TERMS = 2
SECOND_TERM_SHARE = 0.2
"""A second term must gain this share of the first: less is the resolution of the first one's knots."""
WHITE_WITH_ONE_TERM, SINGLE_TERM_GAIN = 1.5, 1.1
"""One term alone explains the session where averages of its residual vary no more than so many times white noise, and
it must gain so much more than the effects found: less is the shape of one of them."""
OUTWEIGHS = 2.5
"""Or it gains so many times what the effects gain. Drag and rolling resistance are one function of speed: while the
second is not found yet, that function gains 1.3 times what is named."""
SHOWN = 6
"""So many of the terms tried are reported."""
OWN_SHARE = 0.3
"""An effect that gained so much of what the term gains, before there was one, is no stand-in."""


@dataclass(frozen=True)
class Explanation:
    """What explains the session: effects with their gains given the rest, terms, the fit, and all terms tried.

    `setting` has the terms, with their bases, in it; `search` is the one that found the effects.
    """

    setting: Setting
    search: Search
    accepted: tuple[str, ...]
    gains: Mapping[str, Evidence]
    terms: tuple[Term, ...]
    fit: Fit
    tried: tuple[Term, ...]


@dataclass
class Rival:
    """One empirical term on the declared model, against all that the catalogue finds; looked for when first asked."""

    setting: Setting
    progress: Progress
    trials: list[Term] = field(default_factory=list)

    def outweighs(self, base: Fit, current: Fit) -> bool:
        """Whether it explains so much more than `current` that no further effect will make up for it."""
        return self._ratio(base, current) > OUTWEIGHS

    def suffices(self, base: Fit, current: Fit) -> bool:
        """Whether it explains the session to its noise and more of it than the end of a search, or far more."""
        ratio = 0.0 if self.setting.over() else self._ratio(base, current)
        if ratio < SINGLE_TERM_GAIN:
            return False
        fit = self.trials[0].fit
        return ratio > OUTWEIGHS or (fit is not None and not structured(fit, WHITE_WITH_ONE_TERM))

    def _ratio(self, base: Fit, current: Fit) -> float:
        """What it gains relative to what `current` gains over `base`; 0 where `current` leaves no structure."""
        if not structured(current, NOT_WHITE):
            return 0.0
        if not self.trials:
            self.trials = search_terms(self.setting, self.setting.found_road, base, self.progress)
        best = self.trials[0]
        if best.fit is None or not _earns_its_place(best, self.setting.record, 0.0):
            return 0.0
        return best.evidence.gain / max(_total_gain(base, current), 1.0)


def with_terms(setting: Setting, found: Search, rival: Rival, progress: Progress) -> Explanation:
    """What the catalogue found, and empirical terms for what it leaves; first a stretch of other grip in some laps.

    What was driven there bends tyres and names of all laps, and no lap to come is said to have it: it is left out of
    the fit and all is sought again. Where laps agree about the change it is a term, where one lap shows it a leftover.
    Look-alikes of effects that the search has accepted are terms from the start.
    """
    look_alikes, found = split_look_alikes(found)
    for term in look_alikes:
        setting = term.added_to(setting)
    outcome = _with_stretches(setting, found, rival, progress)
    return replace(outcome, terms=(*look_alikes, *outcome.terms), tried=(*look_alikes, *outcome.tried))


def _with_stretches(setting: Setting, found: Search, rival: Rival, progress: Progress) -> Explanation:
    """What the catalogue found, empirical terms, and a stretch of other grip in some laps."""
    bent = None if rival.suffices(found.start, found.final) else _of_some_laps(setting, found, progress)
    if bent is None:
        return _with_terms(setting, found, rival, progress)
    progress("without what was driven on another grip")
    elsewhere = replace(setting, record=without(setting.record, [bent.stretch]))
    rival = Rival(elsewhere, progress)
    outcome = _with_terms(elsewhere, search(elsewhere, progress, enough=rival.outweighs), rival, progress)
    return _with_stretch(outcome, setting.record, bent)


def _of_some_laps(setting: Setting, found: Search, progress: Progress) -> StretchTerm | None:
    """A stretch that not every lap has, if it earns its place; of one lap, if it gains as much and holds most."""
    if setting.over() or not structured(found.final, NOT_WHITE):
        return None
    least = max(TERM_SHARE * _blocks(setting.record), TERM_RELATIVE * _total_gain(found.start, found.final))
    local = localised(setting, found.accepted, found.final, least)
    if local is None or local[0].stretch.every_lap:
        return None
    one, share = local
    if len(one.stretch.laps) < LEAST_LAPS:
        return StretchTerm.of(one) if share > MOST else None
    term = fitted(setting, found.accepted, found.final, one, progress)
    return term if _can_be_added(term, setting, found.start, found.final) else None


def _with_stretch(outcome: Explanation, whole: Record, bent: StretchTerm) -> Explanation:
    """With the change of grip that the `whole` record shows around what was found without the stretch, as a term."""
    if len(bent.stretch.laps) < LEAST_LAPS:
        return outcome
    setting = outcome.setting
    record = replace(setting.record, rows=whole.rows, lap=whole.lap)
    found = around(replace(outcome.fit, predictor=Predictor(outcome.fit.predictor.model, record)))
    if len(found.stretch.laps) < LEAST_LAPS:
        return outcome
    term = replace(StretchTerm.of(found, (found.change, found.std)), evidence=bent.evidence)
    setting = term.added_to(setting)
    fit = fit_names(setting, outcome.accepted, outcome.fit)
    return replace(outcome, setting=setting, fit=fit, terms=(*outcome.terms, term), tried=(bent, *outcome.tried))


def _with_terms(setting: Setting, found: Search, rival: Rival, progress: Progress) -> Explanation:
    """What the catalogue found, and empirical terms for what it leaves.

    Terms are added while they earn their place; effects that were only standing in for them are dropped. Beside a
    stretch of other grip the catalogue is searched again: what was found before was found on laps that it bent.
    """
    terms: list[Term] = []
    tried: list[Term] = []
    if rival.suffices(found.start, found.final):
        terms, tried = rival.trials[:1], rival.trials[:SHOWN]
        setting, found = _on_top(terms[0], setting, found, progress)
    checked, current = found.checked, found.final
    while len(terms) < MAX_TERMS and structured(current, NOT_WHITE) and not setting.over():
        trials = _trials(setting, tuple(checked.gains), current, progress)
        tried.extend(trials[:SHOWN])
        least = SECOND_TERM_SHARE * terms[0].evidence.gain if terms else 0.0
        worthy = [t for t in trials if t.evidence.gain > least and _can_be_added(t, setting, found.start, current)]
        joined = (_joined(t, setting, found, tuple(checked.gains), progress) for t in worthy)
        chosen = next((one for one in joined if one is not None), None)
        if chosen is None:
            break
        term, setting, checked, current = chosen
        terms.append(term)
        if isinstance(term, StretchTerm):
            again = search(setting, progress, current)
            if compare(current.held_out(), again.final.held_out(), current.normal.count).gain > 0.0:
                checked, current = again.checked, again.final
                found = replace(again, base=found.base, start=found.start, rounds=(*found.rounds, *again.rounds))
    checked, current = without_proxies(setting, checked, current, progress)
    gains = checked.gains
    ordered = tuple(sorted(gains, key=lambda n: -gains[n].gain))
    return Explanation(setting, found, ordered, gains, tuple(terms), current, tuple(tried))


def _can_be_added(term: Term, setting: Setting, start: Fit, current: Fit) -> bool:
    return term.fit is not None and _earns_its_place(term, setting.record, _total_gain(start, current))


def _trials(setting: Setting, names: Sequence[str], fit: Fit, progress: Progress) -> list[Term]:
    """Terms beside these effects, by held-out evidence: splines of one signal, and another grip on a stretch."""
    trials = search_terms(setting, names, fit, progress)
    fitted = [t for t in trials if t.fit is not None]
    least = TERM_SHARE * _blocks(setting.record)
    together = [*fitted, *search_stretch(setting, names, fit, least, progress)]
    return sorted(together, key=lambda t: -t.evidence.gain) + trials[len(fitted) :]


def _joined(
    term: Term, setting: Setting, found: Search, names: tuple[str, ...], progress: Progress
) -> tuple[Term, Setting, Checked, Fit] | None:
    """The term beside the effects, less those that only stood in for it; None where it is a copy of an effect.

    A spline can copy what physics explains. What gained a fair share of the term's gain before there was one stays,
    and a term for which an effect that gained more would have to go is the copy.
    """
    assert term.fit is not None
    setting = term.added_to(setting)
    most = term.evidence.gain
    own = [n for n in names if found.gains[n].gain >= OWN_SHARE * most]
    stronger = {n for n in own if found.gains[n].gain > most}
    if not all(believed(term.fit, n) for n in stronger):
        return None
    checked, fit = _drop_proxies(setting, own, names, term.fit, progress)
    return (term, setting, checked, fit) if stronger <= set(checked.gains) else None


def _on_top(term: Term, setting: Setting, found: Search, progress: Progress) -> tuple[Setting, Search]:
    """What the catalogue still explains with the term always active; the base stays the declared model."""
    assert term.fit is not None
    setting = term.added_to(setting)
    if not structured(term.fit, NOT_WHITE):
        road, fit, checked = recheck(setting, list(setting.found_road), term.fit, progress)
        return setting, Search(found.base, found.start, fit, tuple(road), found.rounds, checked, {})
    on_top = search(setting, progress, term.fit)
    return setting, replace(on_top, base=found.base, start=found.start, rounds=(*found.rounds, *on_top.rounds))


def _total_gain(base: Fit, current: Fit) -> float:
    return compare(base.held_out(), current.held_out(), base.normal.count).gain if current is not base else 0.0


def _earns_its_place(term: Term, record: Record, total: float) -> bool:
    return term.evidence.gain > max(TERM_SHARE * _blocks(record), TERM_RELATIVE * total) and term.repeats(record)


def _blocks(record: Record) -> int:
    return int(record.rows.shape[0] * record.rows.shape[1])


def _drop_proxies(
    setting: Setting, own: Collection[str], names: Collection[str], fit: Fit, progress: Progress
) -> tuple[Checked, Fit]:
    """Remove, weakest first, effects that gain little once the empirical term is there; those in `own` if nothing."""
    kept = list(names)
    while True:
        checked = check_each(setting, kept, fit, progress, ", with the empirical term")
        gains = checked.gains
        earning = [gains[n].gain > 1.0 if n in own else earns_its_place(gains[n], setting, 0.0) for n in kept]
        weak = [n for n, earns in zip(kept, earning, strict=True) if not earns or not believed(fit, n)]
        weak = [n for n in weak if n not in setting.measured_road]
        if not weak:
            return checked, fit
        worst = min(weak, key=lambda n: gains[n].gain)
        kept.remove(worst)
        fit = checked.without[worst]
