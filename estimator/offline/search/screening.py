"""Which candidates are worth a whole fit: their predicted evidence from linearisations at the current one."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace

import numpy as np

from estimator.model.declared_vehicle import all_candidates
from estimator.model.effect import Effect
from estimator.model.parameters import Parameter
from estimator.offline.fit.prediction_error import Fit, Point
from estimator.offline.predict.predict import Predictor
from estimator.offline.record.record import Record, available
from estimator.offline.record.unknown_inputs import vy_effects
from estimator.offline.search.evidence import compare
from estimator.offline.search.trial import Setting, Trial, warm_start
from estimator.offline.search.workers import FitJob, begin_each, fit_each
from hil_gateway.process.arrays import Array

SCREENING_STRIDE = 3
"""Screening uses every third window."""
SCREENING_ITERATIONS = 3
"""Steps of a candidate that is stationary at its neutral value and cannot be screened there."""


def candidates(record: Record, active: Collection[str]) -> list[Effect]:
    """Effects that can be tried: their signals are there, what they build on is active, and the log can tell them."""
    signals, always = available(record), {effect.name for effect in vy_effects(record.vy_displaced)}
    there = {p.quantity for name in active for p in all_candidates()[name].parameters}
    return [
        e for e in all_candidates().values()
        if e.name not in active and e.hidden_by not in always and set(e.needs) <= signals
        and (not e.requires_any or there.intersection(e.requires_any))
    ]  # fmt: skip


def open_candidates(setting: Setting, accepted: Sequence[str]) -> list[Effect]:
    """Effects of the catalogue that a search may still add: not accepted, not in the model in force, not ruled out."""
    active = {*accepted, *setting.active_names}
    ids = {effect.id for name, effect in all_candidates().items() if name in active}
    possible = candidates(setting.record, active)
    return [effect for effect in possible if effect.name not in setting.untried and effect.id not in ids]


def screen(
    setting: Setting,
    accepted: Sequence[str],
    current: Fit,
    progress: Callable[[str], None],
    effects: Sequence[Effect],
) -> list[Trial]:
    """Predicted evidence of each of `effects` on part of the windows, best first, from linearisations there."""
    return begin_screen(setting, accepted, current, progress, effects)()


def begin_screen(
    setting: Setting,
    accepted: Sequence[str],
    current: Fit,
    progress: Callable[[str], None],
    effects: Sequence[Effect],
) -> Callable[[], list[Trial]]:
    """The same, begun where `setting` has workers; what is returned does the rest."""
    setting, current = _thinned(setting, current)
    before, count = current.held_out(), SCREENING_STRIDE * current.normal.count
    alone = [e for e in effects if e.initial or e.profile]
    short = begin_each(setting, current, [_short_fit(accepted, e) for e in alone], progress)

    def rest() -> list[Trial]:
        trials, far = _screen_together(setting, accepted, [e for e in effects if e not in alone], current, before)
        fits = [*short(), *fit_each(setting, current, [_short_fit(accepted, e) for e in far], progress)]
        for effect, done in zip((*alone, *far), fits, strict=True):
            trials.append(Trial(effect.name, compare(before, done.held_out(), count)))
        return sorted(trials, key=lambda t: -t.evidence.gain)

    return rest


def _short_fit(accepted: Sequence[str], effect: Effect) -> FitJob:
    names = (*accepted, effect.name)
    return FitJob(" + ".join(names), names, iterations=1 if effect.profile else SCREENING_ITERATIONS)


def _thinned(setting: Setting, current: Fit) -> tuple[Setting, Fit]:
    """The search and its fit on every so many windows."""
    record = current.predictor.record.every(SCREENING_STRIDE)
    predictor = Predictor(current.predictor.model, record)
    normal = Point.at(predictor, current.parameters, current.noise).normal()
    return replace(setting, record=record), Fit(predictor, current.parameters, normal, current.noise)


def _screen_together(
    setting: Setting, accepted: Sequence[str], effects: Sequence[Effect], current: Fit, before: Array
) -> tuple[list[Trial], list[Effect]]:
    """One linearisation of the model with all `effects` at their neutral values; those whose step goes too far."""
    model = setting.model(accepted)
    wide = replace(model, effects=(*model.effects, *effects))
    predictor = Predictor(wide, current.predictor.record)
    at = warm_start(predictor, predictor.start([p.prior for p in wide.tyre_table]), current)
    normal = Point.at(predictor, at, current.noise).normal()
    base = [i for i in range(predictor.size) if i < len(wide.tyre_table)]
    places = {b.effect.name: range(b.parameters.start, b.parameters.stop) for b in predictor.blocks}
    for block in current.predictor.blocks:
        base.extend(places[block.effect.name])
    trials, far = list[Trial](), list[Effect]()
    for effect in effects:
        rows = np.array([*base, *places[effect.name]])
        part = normal.subset(rows)
        end = at[rows] + part.step(current.normal.variance)
        table = [predictor.table[i] for i in places[effect.name]]
        passed = [_passed(p, v) for p, v in zip(table, end[-len(table) :], strict=True)]
        if any(bound not in (None, p.prior) for p, bound in zip(table, passed, strict=True)):
            far.append(effect)
            continue
        neutral = len(table) == 1 and passed != [None]
        after = before if neutral else part.held_out(current.normal.variance)
        trials.append(Trial(effect.name, compare(before, after, SCREENING_STRIDE * normal.count)))
    return trials, far


def _passed(parameter: Parameter, value: float) -> float | None:
    """The bound that a step to `value` would cross."""
    if parameter.lower <= value <= parameter.upper:
        return None
    return parameter.lower if value < parameter.lower else parameter.upper
