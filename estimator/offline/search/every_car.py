"""Effects that every car has, tried together: what one does may hide the others.

Brakes, axle loads and the friction ellipse act in the same bends. With one of them alone its size is not believed, and
one by one none is found.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np

from estimator.model.declared_vehicle import all_candidates
from estimator.model.effect import Effect
from estimator.offline.fit.prediction_error import Fit
from estimator.offline.search.acceptance import can_be_accepted, stays
from estimator.offline.search.evidence import Evidence, compare
from estimator.offline.search.plausible import believed
from estimator.offline.search.screening import open_candidates
from estimator.offline.search.trial import Setting, Trial, fit_names
from estimator.offline.search.workers import FitJob, fit_each

SHOWN = 2
"""A session that shows so many of them is of a car that has them all."""


def shows_a_real_car(accepted: Sequence[str]) -> bool:
    """Whether enough of what every car has is accepted to expect the rest."""
    return sum(all_candidates()[name].on_every_car for name in accepted) >= SHOWN


def expected_by_others(accepted: Sequence[str]) -> list[str]:
    """Those of the accepted effects that every car has and that the others are enough to expect."""
    every = [name for name in accepted if all_candidates()[name].on_every_car]
    return [name for name in every if shows_a_real_car([other for other in every if other != name])]


def with_every_car(setting: Setting, accepted: Sequence[str], current: Fit) -> tuple[list[str], Fit]:
    """The accepted effects with all that every car has, as far as each earns its place beside the others.

    What does not is dropped one by one. The quadratic of the fit says which comes next, and the fit without it whether
    it goes: what stands in for another once that is gone, the quadratic does not know. A last one to be added is left
    to the rounds of the search, which try each alone.
    """
    added, fit = fitted_together(setting, accepted, current)
    kept, sure = list(accepted), {*setting.found_road}
    while len(added) > 1:
        names = [*kept, *added]
        gains = {name: gain_beside_others(fit, name) for name in names if name not in sure}
        weak = [n for n in gains if not _earned(Trial(n, gains[n], fit), setting, n in added)]
        if not weak:
            return names, fit
        least = min(weak, key=lambda n: gains[n].gain)
        without = fit_names(setting, [n for n in names if n != least], fit)
        if _earned(Trial(least, _gain(without, fit), fit), setting, least in added):
            sure.add(least)
            continue
        (added if least in added else kept).remove(least)
        fit = without
    return list(accepted), current


def _gain(before: Fit, after: Fit) -> Evidence:
    return compare(before.held_out(), after.held_out(), after.normal.count)


def _earned(trial: Trial, setting: Setting, new: bool) -> bool:
    """As a new effect has to, or as one accepted before."""
    if new:
        return can_be_accepted(trial, setting, 0.0)
    return trial.fit is not None and believed(trial.fit, trial.name) and stays(trial.evidence, setting)


def fitted_together(setting: Setting, accepted: Sequence[str], current: Fit) -> tuple[list[str], Fit]:
    """All that every car has and the model lacks, fitted beside the accepted; of its forms those that explain most."""
    forms = on_every_car(setting, accepted)
    jobs = [FitJob(" + ".join(added), (*accepted, *added)) for added in forms]
    fits = fit_each(setting, current, jobs, lambda _: None)
    return max(zip(forms, fits, strict=True), key=lambda one: _gain(current, one[1]).gain)


def on_every_car(setting: Setting, accepted: Sequence[str]) -> list[list[str]]:
    """What every car has, the log can show and the model lacks; once with each form of an effect that has several."""
    every = [effect for effect in all_candidates().values() if effect.on_every_car]

    def open_beside_the_others(effect: Effect) -> bool:
        others = {*accepted, *(other.name for other in every if other.id != effect.id)}
        return effect.name not in others and effect in open_candidates(setting, [*others])

    forms: dict[str, list[str]] = {}
    for effect in filter(open_beside_the_others, every):
        forms.setdefault(effect.id, []).append(effect.name)
    return [list(names) for names in product(*forms.values())]


def gain_beside_others(fit: Fit, name: str) -> Evidence:
    """What an effect of a fit gains given all others, by the quadratic of the fit.

    The less an effect does, the nearer is the model without it, and the more exact the quadratic.
    """
    block = next(b for b in fit.predictor.blocks if b.effect.name == name)
    rows = np.arange(block.parameters.start, block.parameters.stop)
    neutral = np.array([p.prior for p in fit.predictor.table[block.parameters]])
    without = fit.normal.at(rows, neutral - fit.parameters[rows])
    return compare(without.held_out(fit.normal.variance), fit.held_out(), fit.normal.count)
