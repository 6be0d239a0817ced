"""Learner process: laps, alerts and models in; proposed models, and why the model in force stays, out.

Diagnosis runs in a child at the lowest priority. What it finds is proposed only by `rule.why_not`, and a model that was
adopted stays only by `rule.regress` of the first whole lap with it. Nothing that drives waits for this process.
"""

from __future__ import annotations

import os
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from estimator.learner.collect import Collector
from estimator.learner.find import LEAST_LAPS, FirstLap, Found, Task, find, judge
from estimator.learner.job import NICENESS, ChildJob, Failed, Running
from estimator.learner.rule import Errors, mean_ratio, regress
from hil_gateway.bus.interface import Bus
from hil_gateway.bus.messages import ModelRevision
from hil_gateway.bus.proposal import ModelProposal, Outcome
from hil_gateway.bus.topics import ALERT, MODEL_PROPOSAL, MODEL_REVISION
from hil_gateway.config import Config
from hil_gateway.process.clock import NS_PER_S, SystemClock

PERIOD_S = 0.1
AGAIN_LAPS = 2
"""new laps before another diagnosis: with fewer it would say the same"""
USE_AFTER_NS = 2 * NS_PER_S
"""from a proposal until the estimator uses it: the time to build its belief, ten times over"""
ADOPTION_NS = 300 * NS_PER_S
"""the planner compiles functions for other effects at low priority: a minute, several on a busy computer"""
MODELS_KNOWN = 1000
"""newest revisions whose effects are remembered: a quarter of an hour of one a second"""

Start = Callable[[Callable[[Any], Any], Any], Running]
Effects = tuple[str, ...]


@dataclass
class Probation:
    """A proposed model until the first whole lap with it is over; `first_lap` once the planner drives with it."""

    model: Effects
    found: Effects
    before: ModelRevision
    began_ns: int
    first_lap: int | None = None
    lap_before_s: float = 0.0
    lap_s: float = 0.0
    """of that first whole lap"""


class Learner:
    """Decides when to diagnose, what to propose, and when to take it back; `start` runs work beside it."""

    def __init__(self, config: Config, bus: Bus, start: Start = ChildJob) -> None:
        self._config, self._bus, self._start = config, bus, start
        self._laps = Collector(bus)
        self._revisions = bus.subscribe(MODEL_REVISION, depth=16)
        self._alerts = bus.subscribe(ALERT, depth=16)
        self._declared: ModelRevision | None = None
        self._current: ModelRevision | None = None
        self._effects_of: OrderedDict[str, Effects] = OrderedDict()
        self._job: Running | None = None
        self._trial: Probation | None = None
        self._withdrawn: set[Effects] = set()
        self._diagnosed_at, self._alerted, self._seq = -1, False, 0

    @property
    def received(self) -> bool:
        """Whether a vehicle state has ever come."""
        return self._laps.stamp_ns > 0

    def step(self, now_ns: int) -> None:
        """Take in what has arrived and do what is due."""
        self._laps.step(now_ns)
        self._hear(now_ns)
        if self._job is not None:
            self._take(self._job.poll(), now_ns)
        elif self._trial is not None:
            self._watch(self._trial, now_ns)
        elif self._due():
            self._diagnose(now_ns)

    def close(self) -> None:
        """End what is under way."""
        if self._job is not None:
            self._job.stop()

    def _hear(self, now_ns: int) -> None:
        self._alerted = bool(self._alerts.poll(now_ns)) or self._alerted
        for revision in self._revisions.poll(now_ns):
            self._declared = self._declared or revision
            self._current = revision
            self._effects_of[revision.revision] = _names(revision)
            if len(self._effects_of) > MODELS_KNOWN:
                self._effects_of.popitem(last=False)

    def _due(self) -> bool:
        """After the first laps, and then where the monitor says that the model has stopped explaining."""
        if self._current is None or len(self._laps.complete) < LEAST_LAPS:
            return False
        first = self._diagnosed_at < 0
        return first or (self._alerted and self._laps.done >= self._diagnosed_at + AGAIN_LAPS)

    def _diagnose(self, now_ns: int) -> None:
        self._diagnosed_at, self._alerted = self._laps.done, False
        laps = self._laps.complete
        text = f"diagnosing laps {laps[0] + 1} to {laps[-1] + 1} beside the drive, the last one held out"
        self._say(now_ns, Outcome.STARTED, text)
        self._job = self._start(find, self._task())

    def _task(self) -> Task:
        assert self._declared is not None and self._current is not None
        return Task(self._laps.columns(), self._declared, self._current, self._config)

    def _take(self, result: Any | None, now_ns: int) -> None:
        """What the child has come to, if it has."""
        if result is None:
            return
        self._job = None
        if isinstance(result, Found):
            self._decide(result, now_ns)
        elif self._trial is not None:
            self._end_trial(self._trial, result, now_ns)
        else:
            self._say(now_ns, Outcome.KEPT, f"the diagnosis came to nothing: {result.reason}")

    def _decide(self, found: Found, now_ns: int) -> None:
        """Propose what was found, or say why not."""
        assert self._current is not None
        reason = found.reason
        if found.effects in self._withdrawn:
            reason = "driven with before, and withdrawn"
        if reason:
            self._say(now_ns, Outcome.KEPT, reason, found.effects)
            return
        self._trial = Probation(_names(found.revision), found.effects, self._current, now_ns)
        self._say(now_ns, Outcome.PROPOSED, _gains(found), found.effects, found.revision)

    def _watch(self, trial: Probation, now_ns: int) -> None:
        """Follow a proposed model from the planner's first plan with it to the end of its first whole lap."""
        plan = self._laps.plan
        taken = plan is not None and self._effects_of.get(plan.revision) == trial.model
        if trial.first_lap is None:
            if taken:
                trial.first_lap, trial.lap_before_s = self._laps.done + 1, self._laps.lap_s(self._laps.complete[-1])
            elif now_ns - trial.began_ns > ADOPTION_NS:
                self._withdraw(trial, "the planner did not take it", now_ns)
        elif not taken:
            self._withdraw(trial, "plans with it failed, the planner gave it back", now_ns)
        elif whole := [lap for lap in self._laps.complete if lap >= trial.first_lap]:
            trial.first_lap = whole[0]  # the one meant may have been broken off
            trial.lap_s = self._laps.lap_s(whole[0])
            self._job = self._start(judge, FirstLap(self._task(), trial.first_lap, trial.before))

    def _end_trial(self, trial: Probation, result: tuple[Errors, Errors] | Failed, now_ns: int) -> None:
        """The verdict of the first whole lap."""
        if isinstance(result, Failed):
            self._withdraw(trial, f"its first lap cannot be judged: {result.reason}", now_ns)
            return
        before, after = result
        if reason := regress(before, after, trial.lap_before_s, trial.lap_s):
            self._withdraw(trial, reason, now_ns)
            return
        self._trial = None
        text = f"the first lap with it: {_ratios(before, after)}; {trial.lap_before_s:.1f} s, then {trial.lap_s:.1f} s"
        self._say(now_ns, Outcome.CONFIRMED, text, trial.found)

    def _withdraw(self, trial: Probation, reason: str, now_ns: int) -> None:
        self._trial = None
        self._withdrawn.add(trial.found)
        self._say(now_ns, Outcome.WITHDRAWN, reason, trial.found, trial.before)

    def _say(
        self, now_ns: int, outcome: Outcome, reason: str, effects: Effects = (), revision: ModelRevision | None = None
    ) -> None:
        use_from_ns = self._laps.stamp_ns + USE_AFTER_NS if revision else 0
        proposal = ModelProposal(
            stamp_ns=now_ns, seq=self._seq, outcome=outcome, lap=self._laps.done, effects=effects, reason=reason,
            revision=revision, use_from_ns=use_from_ns,
        )  # fmt: skip
        self._seq += 1
        self._bus.publish(MODEL_PROPOSAL, proposal)


def _names(revision: ModelRevision) -> Effects:
    return tuple(effect.name for effect in revision.effects)


def _gains(found: Found) -> str:
    """What the found model is better in, over the re-fitted one."""
    return f"on the held-out lap, against the re-fitted model: {_ratios(found.errors['refit'], found.errors['found'])}"


def _ratios(before: Errors, after: Errors) -> str:
    """Errors after over before, by channel."""
    parts = ", ".join(f"{name} {after[name] / before[name]:.2f}" for name in before)
    return f"error after 1 s of prediction times {mean_ratio(before, after):.2f} ({parts})"


def run(config: Config) -> None:
    """Run the process until it is asked to stop."""
    from hil_gateway.bus.zenoh_bus import open_bus
    from hil_gateway.process.lifecycle import SilenceNotice, StopRequest

    os.setpriority(os.PRIO_PROCESS, 0, NICENESS)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # of the child: one processor is what it gets
    stop, clock = StopRequest(), SystemClock()
    bus = open_bus(config.zenoh, "learner")
    learner = Learner(config, bus)
    notice = SilenceNotice("vehicle state", config.zenoh.connect, clock.now_ns())
    try:
        while not stop():
            now_ns = clock.now_ns()
            learner.step(now_ns)
            notice.step(now_ns, learner.received)
            clock.sleep_until(now_ns + round(PERIOD_S * NS_PER_S))
    finally:
        learner.close()
        bus.close()
