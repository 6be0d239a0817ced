"""The planner when solver, estimator, clock or belief fail: plans are never partial, and the car stays on the track."""

from __future__ import annotations

import numpy as np
import pytest
from support.cars.model_car import HORIZON, ModelCar, assert_within_limits, fail_solvers, planner_config, revision_with
from support.promise_figures import record_figure, volume

from hil_gateway.bus import topics
from hil_gateway.bus.messages import Belief, PlanStatus
from planner.plan.exploring import EXPLORING
from planner.solver.qp import QpStatus


@pytest.mark.promise("N4")
def test_forced_failures_give_shifted_then_stop_plans_and_recovery(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = ModelCar(planner_config())
    rig.run(3.0)
    fail_solvers(monkeypatch, rig.planner.adoption.controller.sqp, lambda: QpStatus.ITERATION_LIMIT)
    before = len(rig.plans)
    rig.run(1.5)
    failed = [p.status for p in rig.plans[before:]]
    shifts = failed.count(PlanStatus.SHIFTED)
    assert failed[:shifts] == [PlanStatus.SHIFTED] * shifts
    assert 5 <= shifts <= 9
    assert set(failed[shifts:]) == {PlanStatus.STOP}
    assert all("iteration limit" in p.reason for p in rig.plans[before:])
    slowing = rig.car[3]
    rig.run(0.5)
    assert rig.car[3] < slowing - 1.0
    monkeypatch.undo()
    rig.run(2.0)
    assert {p.status for p in rig.plans[-20:]} == {PlanStatus.SOLVED}
    assert_within_limits(rig)
    record_figure("N4", f"{len(rig.plans)} plans, {len(failed)} with a failing solver: {shifts} shifted, then stops")


def test_a_shifted_plan_is_the_rest_of_the_last_one(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = ModelCar(planner_config())
    rig.run(3.0)
    good = rig.plans[-1]
    fail_solvers(monkeypatch, rig.planner.adoption.controller.sqp, lambda: QpStatus.NOT_FINITE)
    rig.run(0.10)
    shifted = rig.plans[-1]
    assert shifted.status is PlanStatus.SHIFTED
    np.testing.assert_array_equal(shifted.x[: HORIZON - 1], good.x[2:])
    np.testing.assert_array_equal(shifted.steer[: HORIZON - 1], good.steer[2:])


def test_stop_plan_brings_the_car_to_a_stand_on_the_track(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = ModelCar(planner_config())
    rig.run(7.0)
    fail_solvers(monkeypatch, rig.planner.adoption.controller.sqp, lambda: QpStatus.INFEASIBLE)
    rig.run(15.0)
    assert rig.car[3] < 0.5
    assert_within_limits(rig)
    reference = rig.planner.adoption.controller.reference
    for car in rig.cars[700::50]:
        s = reference.find(car[0], car[1])
        point = reference.at(np.array([s]))
        assert np.hypot(car[0] - point.x[0], car[1] - point.y[0]) < 4.0


@pytest.mark.promise("N4")
def test_late_solutions_are_not_used() -> None:
    class SlowSometimes:
        """A stopwatch that jumps by 60 ms in every fifth plan."""

        def __init__(self) -> None:
            self.now, self.calls = 0, 0

        def __call__(self) -> int:
            self.calls += 1
            self.now += 60_000_000 if self.calls % 35 == 0 else 1000
            return self.now

    rig = ModelCar(planner_config(), stopwatch=SlowSometimes())
    rig.run(6.0)
    late = [p for p in rig.plans if p.status is PlanStatus.SHIFTED]
    assert late
    assert all("later than" in p.reason for p in late)
    assert_within_limits(rig)
    assert rig.car[3] > 20.0


class Stalls:
    """A stopwatch that at random moments loses 60 ms: a solver or a machine that is late."""

    def __init__(self, seed: int) -> None:
        self.now, self._rng = 0, np.random.default_rng([5, seed])

    def __call__(self) -> int:
        self.now += 60_000_000 if self._rng.random() < 0.002 else 1000
        return self.now


FAULTY_RUNS = volume(2, 40)


@pytest.mark.parametrize("seed", range(FAULTY_RUNS))
@pytest.mark.promise("N4")
def test_random_faults_never_give_a_partial_plan_or_leave_limits(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """NaN in the state, silent estimator, late and failed solutions, jumping beliefs; every second seed explores."""
    rig, rng = (
        ModelCar(planner_config(**EXPLORING if seed % 2 else {}), stopwatch=Stalls(seed)),
        np.random.default_rng(seed),
    )
    broken_until = 0
    fail_solvers(
        monkeypatch, rig.planner.adoption.controller.sqp,
        lambda: None if rig.now_ns >= broken_until else rng.choice(list(QpStatus)[1:]),
    )  # fmt: skip
    rig.run(1.0)
    for _ in range(volume(450, 900)):
        estimate = rig.estimate()
        fault = rng.random()
        if fault < 0.02:
            estimate = rig.estimate(**{rng.choice(["x", "yaw", "vx", "yaw_rate", "steer"]): float("nan")})
        elif fault < 0.05:
            estimate = None
        elif fault < 0.06:
            broken_until = rig.now_ns + int(rng.integers(10, 300)) * 1_000_000
        elif fault < 0.07:
            factor = rng.uniform(0.2, 5.0, 7)
            names = tuple(rig.planner.adoption.current.revision.tyre)
            values = rig.planner.adoption.current.revision.tyre.values()
            mean = tuple(float(v) * f for v, f in zip(values, factor, strict=True))
            rig.bus.publish(topics.BELIEF, Belief(
                stamp_ns=rig.now_ns, seq=0, layout="per_axle", names=names, mean=mean, samples=1,
                covariance=tuple(tuple(0.01 * (i == j) * mean[i] ** 2 for j in range(7)) for i in range(7)),
                log_det_information=0.0,
            ))  # fmt: skip
            tyre = dict(zip(names, mean, strict=True))
            rig.bus.publish(topics.MODEL_REVISION, revision_with(rig, tyre))
        rig.tick(estimate)
    assert_within_limits(rig)
    assert {p.status for p in rig.plans} >= {PlanStatus.SOLVED, PlanStatus.SHIFTED}
    reference = rig.planner.adoption.controller.reference
    for car in rig.cars[::20]:
        s = reference.find(car[0], car[1])
        _, _, road = reference.stages(np.array([s]))
        middle, half = road[0, 0], road[2, 0]
        point = reference.at(np.array([s]))
        offset = -np.sin(point.heading[0]) * (car[0] - point.x[0]) + np.cos(point.heading[0]) * (car[1] - point.y[0])
        assert abs(offset - middle) < half
    record_figure("N4", f"{FAULTY_RUNS} runs of 900 steps with random faults: all within limits, the car on the track")


def test_silence_before_the_first_estimate_publishes_nothing() -> None:
    rig = ModelCar(planner_config())
    for _ in range(20):
        rig.tick(None)
    assert rig.plans == []
    assert rig.commands == []
