"""A greedy search under way: effects are added, completed, checked and exchanged while they predict better.

Every candidate is fitted together with the tyre parameters and everything accepted so far. Its evidence is the
gain in held-out log-likelihood, every stretch of 30 s predicted by a fit to all the others. One linearisation
screens the whole catalogue; the most promising are fitted to the end. After each acceptance everything accepted is
checked again without it; what no longer earns its place is dropped.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from estimator.model.declared_vehicle import DECLARED, all_candidates
from estimator.offline.fit.prediction_error import Fit
from estimator.offline.search.acceptance import (
    SMALLEST_SHARE,
    can_be_accepted,
    earns_its_place,
    eligible,
    stays,
    structured,
    worth_a_name,
)
from estimator.offline.search.every_car import shows_a_real_car, with_every_car
from estimator.offline.search.evidence import Evidence, compare
from estimator.offline.search.plausible import believed
from estimator.offline.search.screening import begin_screen, open_candidates, screen
from estimator.offline.search.trial import Setting, Trial, fit_names
from estimator.offline.search.workers import FitJob, fit_each

WHITE = 1.1
"""The search ends when averages of the residual vary no more than so many times what white noise would."""
SIMILAR = 0.5
"""Share of an effect's gain from which on another in its place is fitted to the end: linearisations are that rough."""
MAX_EFFECTS = 12
LOOK_AHEAD = 2
"""So many effects may be added on their gain alone if then one follows that earns its place beside them."""
RECHECKED_AT_ONCE = 3
"""Up to so many accepted effects all are checked again after each acceptance; more, only at the end."""
ASKED_FROM = 2
"""From so many effects on that leave structure it is asked whether something else explains the session alone."""
FITTED, PROMISING = 4, 0.25
"""Candidates of a round that are fitted to the end: at most so many, with this share of the best predicted gain."""


@dataclass
class Greedy:
    """A search under way: `start` is what it began from, `names` and `fit` what it has, `rounds` what it tried."""

    setting: Setting
    progress: Callable[[str], None]
    enough: Callable[[Fit, Fit], bool]
    start: Fit
    names: list[str]
    fit: Fit
    rounds: list[tuple[Trial, ...]]
    checked: Checked | None = None
    completed_from: frozenset[str] | None = None
    """effects beside which all that every car has was last tried"""

    def run(self) -> None:
        """Grow, complete and exchange by turns, to the end."""
        self.grow()
        while not self.setting.over() and (self.complete() or self.exchange()):
            self.grow()

    def grow(self) -> None:
        """Add effects while they earn their place; what was added on its gain alone goes again if nothing followed."""
        unsure, sure = 0, (self.names, self.fit, self.checked)
        while self._goes_on():
            trials = _round(self.setting, self.names, self.fit, self.progress)
            self.rounds.append(tuple(trials))
            chosen = [t for t in trials if can_be_accepted(t, self.setting, self.total)]
            if chosen:
                unsure = 0
            else:
                sure = (self.names, self.fit, self.checked) if not unsure else sure
                unsure += 1
            chosen = chosen or _tentative(trials, self.setting, self.total)
            if not chosen or unsure > LOOK_AHEAD:
                break
            before = set(self.names)
            self.names, self.fit = _join(self.setting, self.names, chosen, self.total, self.progress)
            self.checked = None
            if not unsure and len(self.names) <= RECHECKED_AT_ONCE:
                self.recheck()
            if not unsure and self.completed_from is None and shows_a_real_car(self.names) and not self.setting.over():
                self.complete()
            if set(self.names) <= before or self._outweighed():
                break
        if unsure:
            self.names, self.fit, self.checked = sure
        if self.names and self.checked is None:
            self.recheck()

    def _goes_on(self) -> bool:
        """Whether there may be more to find, and time to look for it."""
        more = len(self.names) < MAX_EFFECTS and (not self.names or structured(self.fit, WHITE))
        return more and not self.setting.over()

    def _outweighed(self) -> bool:
        asked = len(self.names) >= ASKED_FROM and not self.setting.over()
        return asked and self.enough(self.start, self.fit)

    def recheck(self) -> None:
        """Drop what no longer earns its place."""
        self.names, self.fit, self.checked = recheck(self.setting, self.names, self.fit, self.progress)

    def exchange(self) -> bool:
        """Replace one effect by a candidate that explains more in its place; whether there was one."""
        if self.checked is None or not structured(self.fit, WHITE):
            return False
        for name in sorted(self.names, key=lambda n: self.gains[n].gain):
            trial = None if name in self.setting.found_road else self._instead_of(name)
            if trial is not None:
                self.put_instead(name, trial)
                return True
        return False

    def put_instead(self, name: str, trial: Trial) -> None:
        """Exchange an effect for that of a trial with all the others."""
        assert trial.fit is not None
        self.names, self.fit = [*(n for n in self.names if n != name), trial.name], trial.fit
        self.rounds.append((trial,))
        self.recheck()

    def complete(self) -> bool:
        """Add together what every car has, where the session shows part of it; whether that explains more."""
        tried, self.completed_from = self.completed_from, frozenset(self.names)
        if tried == self.completed_from or not shows_a_real_car(self.names) or not structured(self.fit, WHITE):
            return False
        self.progress("all that every car has")
        names, fit = with_every_car(self.setting, self.names, self.fit)
        if not self._explains_more(fit):
            return False
        names, fit, checked = recheck(self.setting, names, fit, self.progress)
        if not self._explains_more(fit):
            return False
        self.rounds.extend((Trial(n, checked.gains[n], fit),) for n in names if n not in self.names)
        self.names, self.fit, self.checked = names, fit, checked
        return True

    def _explains_more(self, fit: Fit) -> bool:
        evidence = compare(self.fit.held_out(), fit.held_out(), fit.normal.count)
        return earns_its_place(evidence, self.setting, self.total)

    def _instead_of(self, name: str) -> Trial | None:
        rival = self._rival(name, 1.0, forms=True)
        if rival is None:
            return None
        others, without = self.others(name)
        done = fit_names(self.setting, [*others, rival], without)
        trial = Trial(rival, compare(self.fit.held_out(), done.held_out(), done.normal.count), done)
        return trial if can_be_accepted(trial, self.setting, 0.0) else None

    def look_alikes(self) -> dict[str, str]:
        """Accepted effect -> one believed in its place, over which its lead would not be worth a name."""
        named = [name for name in self.names if name not in self.setting.found_road and name not in DECLARED]
        rivals = {name: rival for name in named if (rival := self._rival(name, SIMILAR, forms=False)) is not None}
        pairs = [(rival, *self.others(name)) for name, rival in rivals.items()]
        jobs = [replace(with_effects((*others, rival)), warm=without) for rival, others, without in pairs]
        fits = fit_each(self.setting, self.fit, jobs, self.progress)
        return {name: rivals[name] for name, fit in zip(rivals, fits, strict=True) if self._as_good(rivals[name], fit)}

    def _as_good(self, rival: str, fit: Fit) -> bool:
        lead = compare(fit.held_out(), self.fit.held_out(), fit.normal.count)
        return eligible(Trial(rival, lead, fit)) and not earns_its_place(lead, self.setting, 0.0)

    def _rival(self, name: str, share: float, *, forms: bool) -> str | None:
        """What explains most in place of an effect, if by linearisation it gains this share of what the effect does.

        `forms`: other forms of the effect count; they are no other finding.
        """
        found = self._in_place_of(name)
        best = next((t for t in found if forms or all_candidates()[t.name].id != all_candidates()[name].id), None)
        if best is None or best.evidence.gain < share * self.gains[name].gain:
            return None
        return best.name

    def _in_place_of(self, name: str) -> list[Trial]:
        """What acts on a channel of an effect, beside the others, best first; of all effects screened side by side."""
        assert self.checked is not None
        if not self.checked.rivals:
            begun = {n: self._begin_in_place_of(n) for n in self.names if n not in self.setting.found_road}
            self.checked.rivals.update({n: rest() for n, rest in begun.items()})
        return self.checked.rivals[name]

    def _begin_in_place_of(self, name: str) -> Callable[[], list[Trial]]:
        others, without = self.others(name)
        channels = set(all_candidates()[name].channels)
        possible = (e for e in open_candidates(self.setting, others) if e.name != name)
        rivals = [e for e in possible if channels & set(e.channels)]
        return begin_screen(self.setting, others, without, self.progress, rivals)

    def others(self, name: str) -> tuple[list[str], Fit]:
        """The other effects, and the fit of them alone."""
        assert self.checked is not None
        return [n for n in self.names if n != name], self.checked.without[name]

    @property
    def gains(self) -> Mapping[str, Evidence]:
        """Of every effect given the others, when last checked."""
        return {} if self.checked is None else self.checked.gains

    @property
    def total(self) -> float:
        """Gain of all effects together."""
        return compare(self.start.held_out(), self.fit.held_out(), self.fit.normal.count).gain


def _tentative(trials: Sequence[Trial], setting: Setting, total: float) -> list[Trial]:
    """The trial that gains most, though not on all stretches: another effect may hide it."""
    fitted = [t for t in trials if eligible(t)]
    return [t for t in fitted if worth_a_name(t.evidence, setting, total)][:1]


def _join(
    setting: Setting, accepted: Sequence[str], chosen: Sequence[Trial], total: float, progress: Callable[[str], None]
) -> tuple[list[str], Fit]:
    """The best trial, and with it those that mainly act on other channels and still earn their place beside it."""
    names, current = [*accepted, chosen[0].name], chosen[0].fit
    assert current is not None
    channels = {chosen[0].evidence.channel}
    for trial in chosen[1:]:
        channel = trial.evidence.channel
        if channel in channels or len(names) >= MAX_EFFECTS or not structured(current, WHITE):
            continue
        progress(" + ".join([*names, trial.name]))
        done = fit_names(setting, [*names, trial.name], current)
        evidence = compare(current.held_out(), done.held_out(), done.normal.count)
        if can_be_accepted(Trial(trial.name, evidence, done), setting, total):
            names, current = [*names, trial.name], done
            channels.add(channel)
    return names, current


def _round(setting: Setting, accepted: Sequence[str], current: Fit, progress: Callable[[str], None]) -> list[Trial]:
    """Screen the catalogue, then fit the most promising to the end; best first."""
    screened = screen(setting, accepted, current, progress, open_candidates(setting, accepted))
    before, count = current.held_out(), current.normal.count
    least = SMALLEST_SHARE * count.sum() / 4
    fitted: dict[str, Trial] = {}
    while names := _promising(screened, fitted, least):
        fits = fit_each(setting, current, [with_effects((*accepted, name)) for name in names], progress)
        trials = [Trial(n, compare(before, f.held_out(), count), f) for n, f in zip(names, fits, strict=True)]
        fitted.update((trial.name, trial) for trial in trials)
    return sorted((fitted.get(t.name, t) for t in screened), key=lambda t: -t.evidence.gain)


def _promising(screened: Sequence[Trial], fitted: Mapping[str, Trial], least: float) -> list[str]:
    """What is to be fitted next: what cannot be accepted neither sets the bar nor takes the place of another."""
    leading = [t for t in screened if t.name not in fitted or eligible(fitted[t.name])][:FITTED]
    enough = max(least, PROMISING * leading[0].evidence.gain) if leading else least
    return [t.name for t in leading if t.evidence.gain > enough and t.name not in fitted]


def with_effects(names: tuple[str, ...]) -> FitJob:
    """The fit of these effects."""
    return FitJob(" + ".join(names), names, judged=True)


@dataclass(frozen=True)
class Checked:
    """Accepted effects put to the test: the fit without each, and the evidence of each given all the others.

    `rivals`: what acts where each does, screened in its place when first asked for.
    """

    without: Mapping[str, Fit]
    gains: Mapping[str, Evidence]
    rivals: dict[str, list[Trial]] = field(default_factory=dict, compare=False)


def check_each(
    setting: Setting, names: Sequence[str], current: Fit, progress: Callable[[str], None], beside: str = ""
) -> Checked:
    """Fit the model without each of the effects of `current`."""
    jobs = [FitJob(f"without {name}{beside}", tuple(n for n in names if n != name)) for name in names]
    after, count = current.held_out(), current.normal.count
    without = dict(zip(names, fit_each(setting, current, jobs, progress), strict=True))
    return Checked(without, {name: compare(f.held_out(), after, count) for name, f in without.items()})


def recheck(
    setting: Setting, accepted: list[str], current: Fit, progress: Callable[[str], None]
) -> tuple[list[str], Fit, Checked]:
    """Drop, one by one, what does not earn its place given the others, or what leaves others no plausible size.

    What has no plausible size beside the others may have one in another form, and leave them theirs.
    """
    while True:
        checked = check_each(setting, accepted, current, progress)
        idle = [n for n in accepted if n not in setting.measured_road and not stays(checked.gains[n], setting)]
        doubted = [n for n in accepted if not believed(current, n)]
        if not idle and not doubted:
            return accepted, current, checked
        reformed = None if idle else _in_another_form(setting, accepted, checked, doubted, progress)
        if reformed is not None:
            accepted, current = reformed
            continue
        worst = min(idle or _to_blame(checked) or doubted, key=lambda n: checked.gains[n].gain)
        accepted = [n for n in accepted if n != worst]
        current = checked.without[worst]


def _in_another_form(
    setting: Setting, accepted: Sequence[str], checked: Checked, doubted: Sequence[str], progress: Callable[[str], None]
) -> tuple[list[str], Fit] | None:
    """A doubted effect in another of its forms, where that earns its place and all are believed; None without one."""
    for name in doubted:
        others, without = [n for n in accepted if n != name], checked.without[name]
        forms = [e.name for e in open_candidates(setting, others) if e.id == all_candidates()[name].id]
        jobs = [with_effects((*others, form)) for form in forms if form != name]
        for job, fit in zip(jobs, fit_each(setting, without, jobs, progress), strict=True):
            gained = compare(without.held_out(), fit.held_out(), fit.normal.count)
            if earns_its_place(gained, setting, 0.0) and all(believed(fit, n) for n in job.names):
                return list(job.names), fit
    return None


def _to_blame(checked: Checked) -> list[str]:
    """Effects without which all the others are believed: the one that gains least is the one that is not there."""
    without = checked.without
    return [name for name, fit in without.items() if all(believed(fit, n) for n in without if n != name)]
