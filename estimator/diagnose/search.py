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

from estimator.diagnose.fit import MAX_ITERATIONS, Fit, fit, normal_at
from estimator.diagnose.noise import Noise
from estimator.diagnose.normal import TINY
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
LAP_SIGNIFICANCE = 2.0
"""The mean gain per lap must exceed so many of its standard errors."""
RELATIVE_SHARE = 0.01
"""Least gain relative to everything accepted so far: less is the imperfect shape of an accepted effect."""
WHITE = 1.1
"""The search ends when averages of the residual vary no more than so many times what white noise would."""
MAX_EFFECTS = 10
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
class Evidence:
    """Held-out gain of a larger model over a smaller one.

    Attributes:
        gain: log-likelihood, natural log, summed over laps and channels.
        channels: (5,) its parts.
        laps: (laps,) its parts.
    """

    gain: float
    channels: Array
    laps: Array

    @property
    def consistent(self) -> bool:
        """Whether the gain per lap is positive beyond its scatter."""
        spread = self.laps.std(ddof=1) / np.sqrt(len(self.laps)) if len(self.laps) > 1 else 0.0
        return bool(self.laps.mean() > LAP_SIGNIFICANCE * spread or np.all(self.laps > 0))


@dataclass(frozen=True)
class Trial:
    """One candidate tried on top of what was accepted; `fit` only where it was fitted to the end."""

    name: str
    evidence: Evidence
    fit: Fit | None = None


def compare(before: Array, after: Array, count: Array) -> Evidence:
    """Held-out evidence from squares (5, laps) of two models, variances concentrated out per channel."""
    total = float(count.sum())
    channels = 0.5 * total * np.log(np.maximum(before.sum(1), TINY) / np.maximum(after.sum(1), TINY))
    difference = before - after
    whole = difference.sum(1)
    weight = np.divide(channels, whole, out=np.zeros(5), where=np.abs(whole) > 1e-12)
    laps = np.einsum("cl,c->l", difference, np.abs(weight))
    return Evidence(float(channels.sum()), channels, laps)


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
    while len(accepted) < MAX_EFFECTS and (not accepted or structured(current, WHITE)):
        trials = _round(setting, accepted, current, progress)
        rounds.append(tuple(trials))
        total = compare(base.held_out(), current.held_out(), base.normal.count).gain
        best = next((t for t in trials if _can_be_accepted(t, setting.record, total)), None)
        if best is None:
            break
        before = set(accepted)
        accepted, current, gains = _recheck(setting, [*accepted, best.name], best.fit, progress)
        if set(accepted) <= before:
            break
    ordered = tuple(sorted(accepted, key=lambda n: -gains[n].gain))
    return Search(base, current, ordered, tuple(rounds), {n: gains[n] for n in ordered})


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
    """Whether `name` is a delay so short that the sampling of the log explains it."""
    block = next(b for b in fit.predictor.blocks if b.effect.name == name)
    return name in SAMPLED and bool(abs(fit.parameters[block.parameters][0]) < fit.predictor.record.step)


def earns_its_place(evidence: Evidence, record: Record, total: float) -> bool:
    """Worth a name, consistent over laps, and not the imperfect shape of what is already there."""
    blocks = record.rows.shape[0] * record.rows.shape[1]
    return evidence.gain > max(SMALLEST_SHARE * blocks, RELATIVE_SHARE * total) and evidence.consistent


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
        weak = [
            n for n in accepted if not earns_its_place(gains[n], setting.record, 0.0) or within_a_sample(current, n)
        ]
        if not weak:
            return accepted, current, gains
        worst = min(weak, key=lambda n: gains[n].gain)
        accepted = [n for n in accepted if n != worst]
        current = fit_names(setting, accepted, current)
