"""When the learner diagnoses, proposes and takes back, by what passes on the bus; and the child that works beside."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from estimator.belief.revision import declared_revision, revision_id
from estimator.learner.find import Found, Task, find, judge
from estimator.learner.job import MOST_BYTES, NICENESS, ChildJob, Failed
from estimator.learner.node import ADOPTION_NS, AGAIN_LAPS, Learner
from estimator.model.parameters import tyre_prior
from hil_gateway.bus import topics
from hil_gateway.bus.interface import LocalBus
from hil_gateway.bus.messages import ActiveEffect, Alert, Estimate, ModelRevision, Plan, PlanStatus, VehicleState
from hil_gateway.bus.proposal import ModelProposal, Outcome
from hil_gateway.car.car import load_car
from hil_gateway.config import Config
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.process.errors import InputError

GOOD = {"vx": 0.2, "vy": 0.1, "yaw_rate": 0.02, "position": 0.2}
BETTER = {name: 0.6 * value for name, value in GOOD.items()}
DECLARED = declared_revision(tyre_prior(load_car(), "per_axle"))
ROWS_A_LAP = 20
LAP_S = 80.0


def with_drag() -> ModelRevision:
    effects = (ActiveEffect(name="aero_drag", parameters={"k": 1.0}),)
    revision = revision_id("per_axle", DECLARED.tyre, effects)
    return DECLARED.model_copy(update={"effects": effects, "revision": revision})


FOUND = Found(("aero_drag",), with_drag(), "", {"refit": GOOD, "in_force": GOOD, "found": BETTER})
NOTHING = Found((), DECLARED, "nothing better", {"refit": GOOD, "in_force": GOOD, "found": GOOD})


UNKNOWN = {"imu": "", "receiver": "", "stood": None, "heading": None}
"""of a state: which sensors made it, and where the car stood before"""


class Bench:
    """A learner whose child's work ends at once with the results the test gives, lap after lap."""

    def __init__(self, *results: Any) -> None:
        self.bus, self.results, self.begun = LocalBus(), list(results), list[tuple[Any, Any]]()
        self.said = self.bus.subscribe(topics.MODEL_PROPOSAL, depth=100)
        self.learner = Learner(Config(), self.bus, self.start)
        self.now_ns, self.lap, self.model = NS_PER_S, 0, DECLARED
        self.moment()

    def start(self, work: Callable[[Any], Any], argument: Any) -> Bench:
        self.begun.append((work, argument))
        return self

    def poll(self) -> Any:
        return self.results.pop(0)

    def stop(self) -> None: ...

    def drive(self, laps: int = 1, lap_s: float = LAP_S) -> list[ModelProposal]:
        """So many laps with the model in force, to the first moment of the next; what was said meanwhile."""
        for tick in range(1, laps * ROWS_A_LAP + 1):
            self.now_ns += round(lap_s / ROWS_A_LAP * NS_PER_S)
            self.lap += tick % ROWS_A_LAP == 0
            self.moment()
        return self.said.poll(self.now_ns)

    def moment(self) -> None:
        zero: dict[str, Any] = dict.fromkeys(VehicleState.model_fields, 0)
        state = VehicleState(**{**zero, "stamp_ns": self.now_ns, "valid": True, "sources": {}, **UNKNOWN})
        none: dict[str, Any] = {**dict.fromkeys(Estimate.model_fields, 0), "delivered": None, "lacks": ""}
        none |= {"agreement": None}
        estimate = Estimate(**{**none, "state_stamp_ns": self.now_ns, "valid": True, "std": (0.1,) * 9})
        self.bus.publish(topics.MODEL_REVISION, self.model)
        self.bus.publish(topics.PLAN, plan_of(self.now_ns, self.lap, self.model))
        self.bus.publish(topics.VEHICLE_STATE, state)
        self.bus.publish(topics.ESTIMATE, estimate)
        for _ in range(3):  # starts, hears the result, acts on it
            self.learner.step(self.now_ns)

    def alert(self) -> None:
        alert = Alert(stamp_ns=self.now_ns, seq=1, channel="ax", condition="driving", strength=4.0)
        self.bus.publish(topics.ALERT, alert)


def test_a_state_without_new_frames_is_no_second_row() -> None:
    bench = Bench()
    for _ in range(ROWS_A_LAP):
        bench.now_ns += 10_000_000
        bench.moment()
        bench.moment()
    bench.drive(2)
    assert (np.diff(bench.learner._laps.columns()["t"]) > 0.0).all()


def plan_of(stamp_ns: int, lap: int, model: ModelRevision) -> Plan:
    rows: dict[str, Any] = dict.fromkeys(("x", "y", "yaw", "vx", "s", "steer", "drive"), (0.0,))
    return Plan(
        stamp_ns=stamp_ns, seq=1, state_stamp_ns=stamp_ns, status=PlanStatus.SOLVED, dt=0.05, lap=lap,
        revision=model.revision, solve_ms=1.0, **rows,
    )  # fmt: skip


def outcomes(said: list[ModelProposal]) -> list[Outcome]:
    return [proposal.outcome for proposal in said]


def test_it_diagnoses_after_three_laps_and_then_when_the_monitor_alerts() -> None:
    bench = Bench(NOTHING, NOTHING)
    assert bench.drive(2) == []
    assert outcomes(bench.drive()) == [Outcome.STARTED, Outcome.KEPT]
    work, task = bench.begun[0]
    assert work is find
    assert isinstance(task, Task)
    assert len(task.columns["t"]) == 3 * ROWS_A_LAP
    assert sorted(set(task.columns["lap"])) == [0.0, 1.0, 2.0]
    assert bench.drive(3) == [], "the model explains: no reason to look again"
    bench.alert()
    assert outcomes(bench.drive(1)) == [Outcome.STARTED, Outcome.KEPT]


def test_an_alert_soon_after_a_diagnosis_waits_for_new_laps() -> None:
    bench = Bench(NOTHING, NOTHING)
    bench.drive(3)
    bench.alert()
    assert bench.drive(AGAIN_LAPS - 1) == []
    assert outcomes(bench.drive()) == [Outcome.STARTED, Outcome.KEPT]


def test_a_better_model_is_proposed_and_confirmed_by_its_first_whole_lap() -> None:
    bench = Bench(FOUND, (GOOD, BETTER))
    said = bench.drive(3)
    assert outcomes(said) == [Outcome.STARTED, Outcome.PROPOSED]
    proposal = said[-1]
    assert proposal.revision == FOUND.revision
    assert proposal.effects == ("aero_drag",)
    assert 0 < proposal.use_from_ns - bench.now_ns < 5 * NS_PER_S
    bench.model = with_drag()
    assert bench.drive(1) == [], "the lap in which it was taken is half the old model's"
    (confirmed,) = bench.drive(1)
    assert confirmed.outcome is Outcome.CONFIRMED
    work, first = bench.begun[-1]
    assert work is judge
    assert (first.lap, first.before) == (4, DECLARED)


@pytest.mark.parametrize(
    ("verdict", "lap_s", "words"),
    [
        ((GOOD, {**GOOD, "yaw_rate": 0.05}), LAP_S, "prediction of yaw_rate is 2.50 times worse"),
        ((GOOD, BETTER), 1.05 * LAP_S, "the first lap with it took 84.0 s"),
        (Failed("too little driving"), LAP_S, "cannot be judged: too little driving"),
    ],
)
def test_a_regress_is_withdrawn_and_never_proposed_again(verdict: Any, lap_s: float, words: str) -> None:
    bench = Bench(FOUND, verdict, FOUND)
    bench.drive(3)
    bench.model = with_drag()
    bench.drive(1)
    (withdrawn,) = bench.drive(1, lap_s)
    assert withdrawn.outcome is Outcome.WITHDRAWN
    assert words in withdrawn.reason
    assert withdrawn.revision == DECLARED
    bench.model = DECLARED
    bench.alert()
    said = bench.drive(2)
    assert outcomes(said) == [Outcome.STARTED, Outcome.KEPT]
    assert "withdrawn" in said[-1].reason


def test_a_model_that_the_planner_gives_back_is_withdrawn_at_once() -> None:
    bench = Bench(FOUND)
    bench.drive(3)
    bench.model = with_drag()
    bench.moment()
    bench.model = DECLARED
    bench.moment()
    (withdrawn,) = bench.said.poll(0)
    assert withdrawn.outcome is Outcome.WITHDRAWN
    assert "gave it back" in withdrawn.reason


def test_a_model_that_the_planner_does_not_take_is_withdrawn() -> None:
    bench = Bench(FOUND)
    bench.drive(3)
    (withdrawn,) = bench.drive(1 + int(ADOPTION_NS / NS_PER_S / LAP_S))
    assert "did not take it" in withdrawn.reason


def test_a_diagnosis_that_fails_is_said_and_nothing_changes() -> None:
    bench = Bench(Failed("not done within 480 s"))
    said = bench.drive(3)
    assert outcomes(said) == [Outcome.STARTED, Outcome.KEPT]
    assert "not done within 480 s" in said[-1].reason
    assert said[-1].revision is None


def test_only_the_newest_laps_are_kept() -> None:
    bench = Bench(NOTHING, NOTHING)
    bench.drive(30)
    bench.alert()
    bench.drive(1)
    _, task = bench.begun[-1]
    assert sorted(set(task.columns["lap"].tolist())) == [25.0, 26.0, 27.0, 28.0, 29.0]


@pytest.mark.parametrize("lie", [2**31 - 1, -5, 0])
def test_laps_are_noted_after_a_plan_with_a_foreign_count(lie: int) -> None:
    bench = Bench(NOTHING)
    bench.drive(1)
    bench.bus.publish(topics.PLAN, plan_of(bench.now_ns, lie, DECLARED))
    bench.drive(1)
    assert bench.drive(2)[-1].outcome is Outcome.KEPT, "three whole laps: the one lied about is left out"


def test_laps_are_noted_after_a_planner_that_begins_again() -> None:
    bench = Bench(NOTHING)
    bench.drive(2)
    bench.lap = 0
    assert bench.drive(1) == [], "what it began with is half a lap"
    assert outcomes(bench.drive(1)) == [Outcome.STARTED, Outcome.KEPT]
    _, task = bench.begun[0]
    assert sorted(set(task.columns["lap"].tolist())) == [0.0, 1.0, 3.0]


def test_a_model_is_judged_though_its_first_lap_was_broken_off() -> None:
    bench = Bench(FOUND, (GOOD, BETTER))
    bench.drive(3)
    bench.model = with_drag()
    bench.drive(1)
    bench.lap = 0
    assert bench.drive(1) == []
    (confirmed,) = bench.drive(1)
    assert confirmed.outcome is Outcome.CONFIRMED
    assert "80.0 s, then 80.0 s" in confirmed.reason


def rank(_: Any) -> tuple[int, int, int]:
    import resource

    limit = resource.getrlimit(resource.RLIMIT_DATA)[0]
    return os.getpriority(os.PRIO_PROCESS, 0), len(os.sched_getaffinity(0)), limit


def refuses(words: Any) -> None:
    raise InputError(str(words))


def never_ends(_: Any) -> None:
    time.sleep(3600.0)


def exits(_: Any) -> None:
    os._exit(3)


def result_of(job: ChildJob) -> Any:
    while (result := job.poll()) is None:
        time.sleep(0.01)
    return result


def test_the_child_gives_way_and_is_bounded() -> None:
    assert result_of(ChildJob(rank, None)) == (NICENESS, 1, MOST_BYTES)


def test_a_child_that_refuses_ends_early_or_never_ends_is_a_reason() -> None:
    assert result_of(ChildJob(refuses, "only 3 s of driving")) == Failed("only 3 s of driving")
    assert "ended early" in result_of(ChildJob(exits, None)).reason
    job = ChildJob(never_ends, None, most_s=0.0)
    assert "not done within 0 s" in result_of(job).reason
    assert not Path(f"/proc/{job._process.pid}").exists()
