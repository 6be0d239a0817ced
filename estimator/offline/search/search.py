"""Search over the catalogue for effects that improve the prediction of laps they were not fitted to, from two starts.

One effect at a time finds what stands alone (`greedy`). Of several that are there at once, none may help without the
others, and another that stands in for all of them is found instead: so the search starts again from what every car has.

Look-alikes then give way to the effect they resemble where they predict no better than it: where a drive does not tell
them apart, what many cars have is likelier than what few have. Effects that explain less of what an accelerometer or
the gyroscope shows than is left unexplained there may only stand in for what leaves that, and are no finding; not so of
a car that shows what every car has, whose rest is no stand-in.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from estimator.model.declared_vehicle import DECLARED
from estimator.model.look_alikes import LOOK_ALIKES
from estimator.offline.fit.prediction_error import Fit
from estimator.offline.record.map_road import ROAD
from estimator.offline.search.acceptance import (
    can_be_accepted,
    earns_its_place,
    explains_more_than_is_left,
    leaves_more_than_noise,
    structured,
)
from estimator.offline.search.every_car import expected_by_others, fitted_together
from estimator.offline.search.evidence import Evidence, compare
from estimator.offline.search.greedy import ASKED_FROM, WHITE, Checked, Greedy, check_each, with_effects
from estimator.offline.search.plausible import there
from estimator.offline.search.screening import open_candidates
from estimator.offline.search.trial import Setting, Trial, fit_names
from estimator.offline.search.workers import fit_each


@dataclass(frozen=True)
class Search:
    """Result of a search.

    Attributes:
        base: the declared model; start: with the road that kinematics show; final: with all that is accepted.
        rounds: every round's trials; checked: each accepted effect given the rest.
        look_alikes: accepted effect -> another that explains the session as well in its place, where there is one.
    """

    base: Fit
    start: Fit
    final: Fit
    accepted: tuple[str, ...]
    rounds: tuple[tuple[Trial, ...], ...]
    checked: Checked
    look_alikes: Mapping[str, str]

    @property
    def gains(self) -> Mapping[str, Evidence]:
        """Of each accepted effect given the rest."""
        return self.checked.gains


def search(
    setting: Setting,
    progress: Callable[[str], None] = lambda _: None,
    warm: Fit | None = None,
    enough: Callable[[Fit, Fit], bool] = lambda base, current: False,
    thorough: bool = True,
) -> Search:
    """Run the search; `progress` is told which candidate is being tried.

    `thorough`: also from a second start, and what cannot be told apart, for which a running loop has no time.
    `enough` is asked, with the declared and the current fit, whether to go on when two effects leave structure.
    """
    progress("declared model, re-fitted")
    base = start = fit_names(setting, (), warm or fit_names(setting, (), None))
    names, rounds = list(setting.found_road), list[tuple[Trial, ...]]()
    if names:
        start, first = _with_road(setting, base, names, progress)
        rounds.extend(first)
    state = Greedy(setting, progress, enough, start, names, start, rounds)
    state.run()
    thorough = thorough and not setting.over()
    if thorough and _many_at_once(state):
        state = better(state, from_every_car(state))
    if not setting.over():
        prefer_effects(state)
    # the way there and back may have led the declared model further
    base = base if state.names else state.fit
    ordered = tuple(sorted(state.names, key=lambda n: -state.gains[n].gain))
    checked = state.checked or Checked({}, {})
    return Search(
        base,
        start,
        state.fit,
        ordered,
        tuple(rounds),
        checked,
        {} if not thorough or setting.over() else state.look_alikes(),
    )


def _many_at_once(state: Greedy) -> bool:
    """Whether several effects of the car are found and leave structure."""
    of_car = [name for name in state.names if name not in (*ROAD, *DECLARED)]
    return len(of_car) >= ASKED_FROM and structured(state.fit, WHITE)


def from_every_car(first: Greedy) -> Greedy:
    """A search that begins with the road and what every car has, fitted together.

    One effect at a time finds what stands alone. Of several that are there at once, none may help without the others,
    and another that stands in for all of them is found instead.
    """
    road = [name for name in first.names if name in ROAD]
    added, fit = fitted_together(first.setting, road, fit_names(first.setting, road, first.start))
    names = [*road, *(name for name in added if there(fit, name))]
    fit = fit_names(first.setting, names, fit)
    second = replace(first, names=names, fit=fit, checked=None, completed_from=frozenset(names))
    second.recheck()
    second.rounds.extend((Trial(name, evidence, second.fit),) for name, evidence in second.gains.items())
    second.run()
    return second


def better(first: Greedy, second: Greedy) -> Greedy:
    """The second where it predicts so much better that an effect would earn its name by it.

    By what stands in for nothing: the rest is not named in the end, however well it predicts.
    """
    one, other = _that_counts(first), _that_counts(second)
    lead = compare(one.held_out(), other.held_out(), one.normal.count)
    return second if second.names and earns_its_place(lead, first.setting, first.total) else first


def _that_counts(state: Greedy) -> Fit:
    """The fit of its effects that stand in for nothing."""
    kept = state.names if state.checked is None else not_proxies(state.setting, state.checked, state.fit)
    return state.fit if len(kept) == len(state.names) else fit_names(state.setting, kept, state.fit)


def _with_road(
    setting: Setting, base: Fit, names: Sequence[str], progress: Callable[[str], None]
) -> tuple[Fit, list[tuple[Trial, ...]]]:
    """The road that kinematics show, before any effect of the car is tried, with a round for each part of it."""
    progress(" + ".join(names))
    done = fit_names(setting, names, base)
    evidence = compare(base.held_out(), done.held_out(), done.normal.count)
    return done, [(Trial(name, evidence, done),) for name in names]


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


def without_proxies(
    setting: Setting, checked: Checked, fit: Fit, progress: Callable[[str], None]
) -> tuple[Checked, Fit]:
    """What is left of the effects of a fit, each put to the test again."""
    kept = not_proxies(setting, checked, fit)
    if len(kept) == len(checked.gains):
        return checked, fit
    fit = fit_names(setting, kept, fit)
    return check_each(setting, kept, fit, progress), fit


def not_proxies(setting: Setting, checked: Checked, fit: Fit) -> list[str]:
    """Names of the effects of a fit that stand in for nothing."""
    names = tuple(checked.gains)
    if not leaves_more_than_noise(fit):
        return [*names]
    sure = {*setting.found_road, *DECLARED, *expected_by_others(names)}
    without, gains = checked.without, checked.gains
    return [n for n in names if n in sure or explains_more_than_is_left(n, gains[n].channel, without[n], fit)]
