"""Look-alikes give way to the effect they resemble where they predict no better than it, beyond scatter.

Where a drive does not tell them apart, what many cars have is likelier than what few have.
"""

from __future__ import annotations

from estimator.model.look_alikes import LOOK_ALIKES
from estimator.offline.search.acceptance import can_be_accepted
from estimator.offline.search.evidence import compare
from estimator.offline.search.greedy import Greedy
from estimator.offline.search.screening import open_candidates
from estimator.offline.search.trial import Trial, fit_names


def prefer_effects(state: Greedy) -> None:
    """Exchange, one by one, the look-alikes of a search that do not lead over their effect."""
    for name in [n for n in state.names if n in LOOK_ALIKES]:
        if name in state.names and (trial := _effect_instead(state, name)) is not None:
            state.put_instead(name, trial)


def _effect_instead(state: Greedy, name: str) -> Trial | None:
    """The effect in place of a look-alike, where it earns its name there and is not led by it."""
    effect, (others, without) = LOOK_ALIKES[name].id, state.others(name)
    if effect not in {other.name for other in open_candidates(state.setting, others)}:
        return None
    fit = fit_names(state.setting, [*others, effect], without)
    trial = Trial(effect, compare(without.held_out(), fit.held_out(), fit.normal.count), fit)
    lead = compare(fit.held_out(), state.fit.held_out(), fit.normal.count)
    return trial if can_be_accepted(trial, state.setting, 0.0) and not lead.consistent else None
