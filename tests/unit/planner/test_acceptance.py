"""Acceptance: every kind of broken plan is refused by code that does not know the solver."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil_gateway.car.vehicle import Vehicle
from hil_gateway.track.loading import load_track
from planner.plan import acceptance
from planner.plan.acceptance import Bounds, Plan, declared_forces, violations
from planner.plan.checks import beside, bounds_of, defects, plan_of
from planner.plan.controller import Controller
from planner.problem.settings import Settings
from planner.solver.sqp import Solution
from planner.studies.bench import bench_controller, clock, start_state


@pytest.fixture(scope="module")
def solved() -> tuple[Controller, Solution]:
    controller, _ = bench_controller(load_track(), Vehicle(), Settings())
    return controller, controller.cold_start(start_state(controller, 620.0), clock)


@pytest.fixture
def case(solved: tuple[Controller, Solution]) -> tuple[Plan, Bounds, acceptance.ForceModel]:
    controller, solution = solved
    tyre = {p.name: v for p, v in zip(controller.problem.model.tyre_table, controller.knowledge.theta, strict=True)}
    bounds = replace(bounds_of(controller.settings, controller.knowledge.load_max, 0.0), information=100.0)
    return plan_of(solution, controller.reference.line), bounds, declared_forces(Vehicle(), tyre)


def test_a_solution_is_accepted(case: tuple[Plan, Bounds, acceptance.ForceModel]) -> None:
    plan, bounds, forces = case
    assert violations(plan, bounds, forces, defects(plan, bounds.dt, forces, Vehicle())) == []


@pytest.mark.promise("N4")
@pytest.mark.parametrize(
    ("name", "value", "at", "broken"),
    [
        ("offset", 9.0, 25, "track"),
        ("offset", -14.0, 25, "track"),
        ("vy", 6.0, 25, "load"),
        ("yaw_rate", 2.5, 25, "load"),
        ("steer", 0.27, 25, "actuator"),
        ("drive", -0.37, 25, "actuator"),
        ("steer", 0.05, 25, "rate"),
        ("drive", -0.3, 25, "rate"),
        ("vx", -2.0, 25, "state"),
        ("vx", 90.0, 25, "state"),
        ("information", 120.0, 25, "information"),
        ("x", np.nan, 25, "not finite"),
        ("drive", np.inf, 3, "not finite"),
    ],
)
def test_one_bad_entry_is_enough(
    case: tuple[Plan, Bounds, acceptance.ForceModel], name: str, value: float, at: int, broken: str
) -> None:
    plan, bounds, forces = case
    column = getattr(plan, name).copy()
    column[at] = value
    assert any(found.startswith(broken) for found in violations(replace(plan, **{name: column}), bounds, forces))


@pytest.mark.parametrize("name", ["x", "y", "yaw", "vx", "vy", "yaw_rate"])
def test_a_plan_that_no_car_can_follow_is_refused(case: tuple[Plan, Bounds, acceptance.ForceModel], name: str) -> None:
    plan, bounds, forces = case
    column = getattr(plan, name).copy()
    column[20:] += {"yaw": 0.1, "yaw_rate": 0.2}.get(name, 1.0)
    moved = replace(plan, **{name: column})
    found = violations(moved, bounds, forces, defects(moved, bounds.dt, forces, Vehicle()))
    assert any(f.startswith("dynamics") for f in found)


def test_recovery_from_beyond_a_limit_must_lead_back(case: tuple[Plan, Bounds, acceptance.ForceModel]) -> None:
    plan, bounds, forces = case
    edge = plan.width_left - bounds.clearance
    back = edge + np.maximum(0.0, 0.5 - 0.05 * np.arange(len(edge)))
    assert violations(replace(plan, offset=back), bounds, forces) == []
    stays = edge + 0.5
    assert any(f.startswith("track") for f in violations(replace(plan, offset=stays), bounds, forces))


def test_offset_is_measured_from_the_race_line(solved: tuple[Controller, Solution]) -> None:
    line = solved[0].reference.line
    index = np.arange(100, 140)
    x = line.x[index] - 2.0 * np.sin(line.heading[index])
    y = line.y[index] + 2.0 * np.cos(line.heading[index])
    offset, left, right, _ = beside(x, y, line.s[index], line)
    np.testing.assert_allclose(offset, 2.0, atol=1e-9)
    np.testing.assert_allclose(left, line.width_left[index], atol=1e-9)
    np.testing.assert_allclose(right, line.width_right[index], atol=1e-9)


def test_forces_agree_with_the_model_of_the_solver(solved: tuple[Controller, Solution]) -> None:
    """Written twice, once in CasADi and once in numpy: the same physics."""
    from estimator.belief.revision import declared_revision, model_of
    from planner.plan.checks import interpreted_forces

    revised = model_of(declared_revision("per_axle"), Vehicle(), 1000.0)
    plain = declared_forces(Vehicle(), declared_revision("per_axle").tyre)
    rng = np.random.default_rng(0)
    vx, vy = rng.uniform(15, 70, 200), rng.uniform(-3, 3, 200)
    rate, steer, drive = rng.uniform(-0.6, 0.6, 200), rng.uniform(-0.2, 0.2, 200), rng.uniform(-0.1, 0.1, 200)
    a, b = (f(vx, vy, rate, steer, drive) for f in (plain, interpreted_forces(revised)))
    for name in ("fx_f", "fy_f", "load_f", "fx_r", "fy_r", "load_r"):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=1e-4, atol=2.0)
