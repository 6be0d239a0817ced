"""Look-alikes give way to the effect they resemble where they predict no better than it, beyond scatter.

Where a drive does not tell them apart, what many cars have is likelier than what few have.
"""

from __future__ import annotations

from dataclasses import replace

from estimator.model.look_alikes import LOOK_ALIKES
from estimator.offline.search.acceptance import can_be_accepted
from estimator.offline.search.evidence import compare
from estimator.offline.search.greedy import Greedy, with_effects
from estimator.offline.search.screening import open_candidates
from estimator.offline.search.trial import Trial
from estimator.offline.search.workers import fit_each


def prefer_effects(state: Greedy) -> None:
    """Exchange, one by one, the look-alikes of a search that do not lead over their effect."""
    for name in [n for n in state.names if n in LOOK_ALIKES]:
        if name in state.names and (trial := _effect_instead(state, name)) is not None:
            state.put_instead(name, trial)


def _effect_instead(state: Greedy, name: str) -> Trial | None:
    """The effect in place of a look-alike, in the form that explains most, where it earns its name there and is not
    led."""
    setting, (others, without) = state.setting, state.others(name)
    forms = [e.name for e in open_candidates(setting, others) if e.id == LOOK_ALIKES[name].id]
    jobs = [replace(with_effects((*others, form)), warm=without) for form in forms if form not in LOOK_ALIKES]
    fits = fit_each(setting, state.fit, jobs, state.progress)
    gains = (compare(without.held_out(), fit.held_out(), fit.normal.count) for fit in fits)
    trials = [Trial(job.names[-1], gain, fit) for job, gain, fit in zip(jobs, gains, fits, strict=True)]
    possible = [t for t in trials if can_be_accepted(t, setting, 0.0) and not _led(state, t)]
    return max(possible, key=lambda t: t.evidence.gain, default=None)


def _led(state: Greedy, trial: Trial) -> bool:
    """Whether what the search has predicts better than a trial, beyond scatter."""
    assert trial.fit is not None
    return compare(trial.fit.held_out(), state.fit.held_out(), state.fit.normal.count).beyond_scatter
