"""Greedy search over the catalogue: what earns its place on laps it was not fitted to.

Every candidate is fitted together with the tyre parameters and everything accepted so far. Its evidence is the
gain in held-out log-likelihood, every stretch of 30 s predicted by a fit to all the others. One linearisation
screens the whole catalogue; the most promising are fitted to the end. After each acceptance everything accepted is
checked again without it; what no longer earns its place is dropped.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from estimator.diagnose.evidence import Evidence, compare
from estimator.diagnose.fit import MAX_ITERATIONS, Fit, fit, normal_at
from estimator.diagnose.noise import Noise
from estimator.diagnose.predict import Predictor
from estimator.diagnose.record import Record, available
from estimator.diagnose.timing import SAMPLED, sampling_effects
from estimator.diagnose.whiteness import structured
from estimator.model.effects import catalogue
from estimator.model.effects.base import Effect
from estimator.model.parameters import Layout
from estimator.model.single_track import SingleTrack

Array = NDArray[np.float64]

SMALLEST_SHARE = 0.02
"""Least gain per block: a signal of about a fifth of the block noise in one channel. Less is not worth a name."""
RELATIVE_SHARE = 0.01
"""Least gain relative to everything accepted so far: less is the imperfect shape of an accepted effect."""
WHITE = 1.1
"""The search ends when averages of the residual vary no more than so many times what white noise would."""
MAX_EFFECTS = 12
LOOK_AHEAD = 2
"""So many effects may be added on their gain alone if then one follows that earns its place beside them."""
RECHECKED_AT_ONCE = 3
"""Up to so many accepted effects all are checked again after each acceptance; more, only at the end."""
FITTED, PROMISING = 5, 0.25
"""Candidates of a round that are fitted to the end: at most so many, with this share of the best predicted gain."""
REWEIGHINGS, REWEIGH_ABOVE = 6, 0.1
"""A fit is repeated with its own residual deviations until these change by less than a tenth."""
SCREENING_STRIDE = 3
"""Screening uses every third window."""
SCREENING_ITERATIONS = 3
"""Steps of a candidate that is stationary at its neutral value and cannot be screened there."""


@dataclass(frozen=True)
class Setting:
    """What stays the same during a search; `extra` are effects always active (empirical terms)."""

    record: Record
    layout: Layout
    prior: Mapping[str, float] | None
    extra: tuple[Effect, ...] = ()

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
    predictor = Predictor(
        model, setting.record if warm is None else replace(setting.record, trajectory=warm.predictor.record.trajectory)
    )
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
    return Noise.white(np.maximum(record.block_noise, UNFITTED_SHARE * spread))


UNFITTED_SHARE = 0.02


def warm_start(predictor: Predictor, start: Array, warm: Fit) -> Array:
    """`start` with tyre parameters and effects replaced by those `warm` already has."""
    size = len(predictor.model.tyre_table)
    start[:size] = warm.parameters[:size]
    known = {b.effect.name: warm.parameters[b.parameters] for b in warm.predictor.blocks}
    for block in predictor.blocks:
        if block.effect.name in known:
            start[block.parameters] = known[block.effect.name]
    return start


def candidates(record: Record, accepted: Sequence[str]) -> list[Effect]:
    """Effects that can be tried: their signals are there, and what they build on is active."""
    signals = available(record)
    return [
        e for e in catalogue().values()
        if e.name not in accepted and set(e.needs) <= signals
        and (not e.requires_any or set(e.requires_any) & set(accepted))
    ]  # fmt: skip


def screen(setting: Setting, accepted: Sequence[str], current: Fit, progress: Callable[[str], None]) -> list[Trial]:
    """Predicted evidence of every candidate on part of the windows, best first, from linearisations there."""
    effects = candidates(setting.record, accepted)
    setting, current = _thinned(setting, current)
    before, count = current.held_out(), SCREENING_STRIDE * current.normal.count
    alone = {e.name for e in effects if e.initial or e.profile}
    together = [e for e in effects if e.name not in alone]
    trials = _screen_together(setting, accepted, together, current, before)
    for effect in effects:
        if effect.name in alone:
            progress(" + ".join([*accepted, effect.name]))
            steps = 1 if effect.profile else SCREENING_ITERATIONS
            done = fit_names(setting, [*accepted, effect.name], current, steps)
            trials.append(Trial(effect.name, compare(before, done.held_out(), count)))
    return sorted(trials, key=lambda t: -t.evidence.gain)


def _thinned(setting: Setting, current: Fit) -> tuple[Setting, Fit]:
    """The search and its fit on every so many windows."""
    chosen = np.arange(setting.record.windows) % SCREENING_STRIDE == 0
    _, number = np.unique(setting.record.lap[chosen], return_inverse=True)
    record = replace(current.predictor.record.select(chosen), lap=number.astype(np.int64))
    predictor = Predictor(current.predictor.model, record)
    normal, _ = normal_at(predictor, current.parameters, current.noise)
    return replace(setting, record=record), Fit(predictor, current.parameters, normal, current.noise)


def _screen_together(
    setting: Setting, accepted: Sequence[str], effects: Sequence[Effect], current: Fit, before: Array
) -> list[Trial]:
    """One linearisation of the model with all `effects` at their neutral values."""
    model = setting.model(accepted)
    wide = replace(model, effects=(*model.effects, *effects))
    predictor = Predictor(wide, current.predictor.record)
    at = warm_start(predictor, predictor.start([p.prior for p in wide.tyre_table]), current)
    normal, _ = normal_at(predictor, at, current.noise)
    base = [i for i in range(predictor.size) if i < len(wide.tyre_table)]
    places = {b.effect.name: range(b.parameters.start, b.parameters.stop) for b in predictor.blocks}
    for block in current.predictor.blocks:
        base.extend(places[block.effect.name])
    trials = []
    for effect in effects:
        rows = np.array([*base, *places[effect.name]])
        part = normal.subset(rows)
        end = at[rows] + part.step(current.normal.variance)
        own = slice(-len(places[effect.name]), None)
        table = [predictor.table[i] for i in places[effect.name]]
        inside = all(p.lower <= v <= p.upper for p, v in zip(table, end[own], strict=True)) or len(table) > 1
        after = part.held_out(current.normal.variance) if inside else before
        trials.append(Trial(effect.name, compare(before, after, SCREENING_STRIDE * normal.count)))
    return trials


@dataclass(frozen=True)
class Search:
    """Result of a search: the accepted fit, every round's trials, the gain of each accepted effect given the rest."""

    base: Fit
    final: Fit
    accepted: tuple[str, ...]
    rounds: tuple[tuple[Trial, ...], ...]
    gains: Mapping[str, Evidence]


def search(setting: Setting, progress: Callable[[str], None] = lambda _: None, warm: Fit | None = None) -> Search:
    """Run the search; `progress` is told which candidate is being tried."""
    progress("declared model, re-fitted")
    base = fit_names(setting, (), warm or fit_names(setting, (), None))
    current, rounds = base, []
    accepted: list[str] = []
    gains: dict[str, Evidence] = {}
    unsure, sure = 0, (accepted, current, gains)
    while len(accepted) < MAX_EFFECTS and (not accepted or structured(current, WHITE)):
        trials = _round(setting, accepted, current, progress)
        rounds.append(tuple(trials))
        total = compare(base.held_out(), current.held_out(), base.normal.count).gain
        chosen = [t for t in trials if _can_be_accepted(t, setting.record, total)]
        if chosen:
            unsure = 0
        else:
            sure = (accepted, current, gains) if not unsure else sure
            unsure += 1
        chosen = chosen or _tentative(trials, setting.record, total)
        if not chosen or unsure > LOOK_AHEAD:
            break
        before = set(accepted)
        accepted, current = _join(setting, accepted, chosen, total, progress)
        gains = {}
        if not unsure and len(accepted) <= RECHECKED_AT_ONCE:
            accepted, current, gains = _recheck(setting, accepted, current, progress)
        if set(accepted) <= before:
            break
    if unsure:
        accepted, current, gains = sure
    if accepted and not gains:
        accepted, current, gains = _recheck(setting, accepted, current, progress)
    ordered = tuple(sorted(accepted, key=lambda n: -gains[n].gain))
    return Search(base, current, ordered, tuple(rounds), {n: gains[n] for n in ordered})


def _tentative(trials: Sequence[Trial], record: Record, total: float) -> list[Trial]:
    """The trial that gains most, though not on all stretches: another effect may hide it."""
    fitted = [t for t in trials if t.fit is not None and not within_a_sample(t.fit, t.name)]
    return [t for t in fitted if worth_a_name(t.evidence, record, total)][:1]


def _join(
    setting: Setting, accepted: Sequence[str], chosen: Sequence[Trial], total: float, progress: Callable[[str], None]
) -> tuple[list[str], Fit]:
    """The best trial, and with it those that mainly act on other channels and still earn their place beside it."""
    names, current = [*accepted, chosen[0].name], chosen[0].fit
    assert current is not None
    channels = {int(np.argmax(chosen[0].evidence.channels))}
    for trial in chosen[1:]:
        channel = int(np.argmax(trial.evidence.channels))
        if channel in channels or len(names) >= MAX_EFFECTS or not structured(current, WHITE):
            continue
        progress(" + ".join([*names, trial.name]))
        done = fit_names(setting, [*names, trial.name], current)
        evidence = compare(current.held_out(), done.held_out(), done.normal.count)
        if _can_be_accepted(Trial(trial.name, evidence, done), setting.record, total):
            names, current = [*names, trial.name], done
            channels.add(channel)
    return names, current


def _round(setting: Setting, accepted: Sequence[str], current: Fit, progress: Callable[[str], None]) -> list[Trial]:
    """Screen the catalogue, then fit the most promising to the end; best first."""
    screened = screen(setting, accepted, current, progress)
    before, count = current.held_out(), current.normal.count
    least = SMALLEST_SHARE * count.sum() / 4
    trials = []
    for place, trial in enumerate(screened):
        if place < FITTED and trial.evidence.gain > max(least, PROMISING * screened[0].evidence.gain):
            progress(" + ".join([*accepted, trial.name]))
            done = fit_names(setting, [*accepted, trial.name], current)
            trials.append(Trial(trial.name, compare(before, done.held_out(), count), done))
        else:
            trials.append(trial)
    return sorted(trials, key=lambda t: -t.evidence.gain)


def _can_be_accepted(trial: Trial, record: Record, total: float) -> bool:
    if trial.fit is None or within_a_sample(trial.fit, trial.name):
        return False
    return earns_its_place(trial.evidence, record, total)


def within_a_sample(fit: Fit, name: str) -> bool:
    """Whether `name` is a lag so short that the sampling of the log explains it; a length counts at the mean speed."""
    block = next(b for b in fit.predictor.blocks if b.effect.name == name)
    if name not in (*SAMPLED, "tyre_relaxation"):
        return False
    record = fit.predictor.record
    speed = float(record.signals["vx"][record.rows].mean()) if block.effect.parameters[0].unit == "m" else 1.0
    return abs(float(fit.parameters[block.parameters][0])) < record.step * speed


def earns_its_place(evidence: Evidence, record: Record, total: float) -> bool:
    """Worth a name, consistent over laps, and not the imperfect shape of what is already there."""
    return worth_a_name(evidence, record, total) and evidence.consistent


def _stays(evidence: Evidence, record: Record) -> bool:
    return worth_a_name(evidence, record, 0.0) and evidence.still_consistent


def worth_a_name(evidence: Evidence, record: Record, total: float) -> bool:
    """Whether the gain is large enough, whatever its scatter."""
    blocks = record.rows.shape[0] * record.rows.shape[1]
    return bool(evidence.gain > max(SMALLEST_SHARE * blocks, RELATIVE_SHARE * total))


def _recheck(
    setting: Setting, accepted: list[str], current: Fit | None, progress: Callable[[str], None]
) -> tuple[list[str], Fit, dict[str, Evidence]]:
    """Drop, weakest first, every accepted effect that no longer earns its place given the others."""
    current = current or fit_names(setting, accepted, None)
    while True:
        gains = {}
        after, count = current.held_out(), current.normal.count
        for name in accepted:
            progress(f"without {name}")
            without = fit_names(setting, [n for n in accepted if n != name], current)
            gains[name] = compare(without.held_out(), after, count)
        weak = [n for n in accepted if not _stays(gains[n], setting.record) or within_a_sample(current, n)]
        if not weak:
            return accepted, current, gains
        worst = min(weak, key=lambda n: gains[n].gain)
        accepted = [n for n in accepted if n != worst]
        current = fit_names(setting, accepted, current)
