"""The generated check of a plan: what numpy and CasADi's virtual machine find, whatever the plan."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.plans.bench import bench_controller, clock, start_state
from hil_gateway.car.car import load_car
from hil_gateway.process.compiled import find_compiler
from hil_gateway.track.loading import load_track
from planner.plan.acceptance import AcceptanceCheck, CheckedPlan, violations
from planner.plan.checks import Roadside, bounds_of, plan_of
from planner.plan.controller import Controller
from planner.problem.settings import declared_settings
from planner.solver.fixed_check import FixedCheck
from planner.solver.functions import build_functions
from planner.solver.sqp import Solution

AHEAD = 6.0
"""m; the nearest point is sought up to some 12 m around"""
pytestmark = pytest.mark.skipif(find_compiler() is None, reason="needs a C compiler")


@pytest.fixture(scope="module")
def controller() -> Controller:
    return bench_controller(load_track(), load_car().vehicle, declared_settings(load_car()))[0]


@pytest.fixture(scope="module")
def solution(controller: Controller) -> Solution:
    return controller.cold_start(start_state(controller, 620.0), clock)


def _generated(controller: Controller) -> FixedCheck:
    assert isinstance(controller.checked, FixedCheck)
    return controller.checked


def _moved(solution: Solution, controller: Controller, metres: float, across: float) -> Solution:
    """The plan so far on along the line, and beside it; its progress runs `AHEAD` of it."""
    reference, z = controller.reference, solution.z.copy()
    z[6] += metres
    point = reference.at(z[6])
    z[0], z[1] = point.x - across * np.sin(point.heading), point.y + across * np.cos(point.heading)
    z[6] += AHEAD
    return replace(solution, z=z, information=np.linspace(0.0, 50.0, z.shape[1] - 1))


@pytest.mark.parametrize(
    ("metres", "across"), [(0.0, 0.3), (-700.0, -2.0), (-4180.0, 1.0), (2890.0, 4.0), (10_000.0, 1.0)]
)
def test_the_road_beside_a_plan_is_the_one_numpy_finds(
    controller: Controller, solution: Solution, metres: float, across: float
) -> None:
    """Also before the first point of the line, over the end of a lap, and laps later."""
    moved, roadside = _moved(solution, controller, metres, across), Roadside(controller.reference.line)
    expected = plan_of(moved, roadside).columns
    found = _generated(controller).lay_out(moved.z, moved.information, roadside)
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)


def test_a_place_that_is_no_number_is_not_looked_up(controller: Controller, solution: Solution) -> None:
    z = solution.z.copy()
    z[6, 3], z[0, 5] = np.nan, np.inf
    plan = CheckedPlan(_generated(controller).lay_out(z, solution.information, Roadside(controller.reference.line)))
    assert np.isfinite(plan.columns[:, 3]).all(), "some point of the line"
    bounds = bounds_of(controller.settings, (1.3, 1.2), 0.0)
    check = AcceptanceCheck(controller.checked, controller.knowledge.theta, np.zeros(0), 1.0)
    assert violations(check(plan, bounds), bounds) == ["not finite"]


def test_it_finds_what_the_virtual_machine_finds(controller: Controller, solution: Solution) -> None:
    interpreted = build_functions(controller.problem, compiled=False).checked
    bounds, theta = bounds_of(controller.settings, (1.3, 1.2), 0.0), controller.knowledge.theta
    plan, rng = plan_of(solution, Roadside(controller.reference.line)), np.random.default_rng(3)
    for spread in (0.0, 0.02, 0.5):
        disturbed = CheckedPlan(plan.columns * (1.0 + spread * rng.standard_normal(plan.columns.shape)))
        checks = [AcceptanceCheck(function, theta, np.zeros(0), 1.0) for function in (controller.checked, interpreted)]
        found, expected = (check(disturbed, bounds) for check in checks)
        np.testing.assert_allclose(found.rows, expected.rows, rtol=1e-9, atol=1e-9)
        assert found.finite
