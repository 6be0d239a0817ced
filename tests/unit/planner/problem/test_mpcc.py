"""The optimal-control problem: Eq. (1), (4), (5), (10) as stage functions, and the SQP method against IPOPT."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from benchmarks.plans.bench import bench_controller, clock, start_state
from benchmarks.plans.reference_nlp import ReferenceNlp
from hil_gateway.car.car import load_car
from hil_gateway.track.loading import load_track
from planner.plan.controller import Controller
from planner.plan.prediction import AT_ONCE, Late
from planner.problem.motion import DRIVE, NU, NZ, PROGRESS, STEER, VX, S
from planner.problem.mpcc import OUTPUTS, into_zone
from planner.problem.settings import declared_settings


@pytest.fixture(scope="module")
def controller() -> Controller:
    """The shipped road course, declared model, 20 s into a lap's geometry with a converged solution."""
    made, _ = bench_controller(load_track(), load_car().vehicle, declared_settings(load_car()))
    made.cold_start(start_state(made, 620.0), clock)
    return made


def _blocks(controller: Controller, z: np.ndarray, du: np.ndarray) -> dict[str, np.ndarray]:
    """Outputs of the stage function with the guess (z, du), by name."""
    sqp = controller.sqp
    inputs = sqp._horizon.inputs
    inputs[0][:], inputs[1][:], inputs[2][:] = z[:, :-1], du, z[:, 1:]
    inputs[3][:], inputs[4][:, 0] = controller.stages, controller.common
    sqp._horizon()
    return {name: out.copy() for name, out in zip(OUTPUTS, sqp._horizon.outputs, strict=False)}


def _perturbed(z: np.ndarray, du: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    scale = np.array([0.3, 0.3, 0.01, 0.5, 0.2, 0.05, 0.3, 0.005, 0.005, 0.5])[:, None]
    return z + scale * rng.standard_normal(z.shape), du + 0.1 * np.abs(du) * rng.standard_normal(du.shape)


@pytest.mark.promise("N2")
@pytest.mark.parametrize("seed", range(3))
def test_linearised_motion_agrees_with_finite_differences(controller: Controller, seed: int) -> None:
    z, du = _perturbed(controller.sqp.z, controller.sqp.du, seed)
    base = _blocks(controller, z, du)
    steps = np.array([1e-3, 1e-3, 1e-5, 1e-4, 1e-4, 1e-5, 1e-3, 1e-6, 1e-6, 1e-4])
    k = 7 + seed
    for i in range(NZ):
        high, low = z[:, k].copy(), z[:, k].copy()
        high[i] += steps[i]
        low[i] -= steps[i]
        ends = [controller.sqp.propagate(x, du[:, k], controller.stages[:, k], controller.common) for x in (high, low)]
        difference = (ends[0] - ends[1]) / (2 * steps[i])
        np.testing.assert_allclose(base["A"][:, NZ * k + i], difference, rtol=1e-5, atol=1e-6)
    for i in range(NU):
        high, low = du[:, k].copy(), du[:, k].copy()
        high[i] += steps[7 + i]
        low[i] -= steps[7 + i]
        ends = [controller.sqp.propagate(z[:, k], u, controller.stages[:, k], controller.common) for u in (high, low)]
        difference = (ends[0] - ends[1]) / (2 * steps[7 + i])
        np.testing.assert_allclose(base["B"][:, NU * k + i], difference, rtol=1e-5, atol=1e-6)


def test_what_is_sent_and_acts_late_is_no_choice_of_the_plan() -> None:
    made, _ = bench_controller(load_track(), load_car().vehicle, declared_settings(load_car()))
    start, late = start_state(made, 620.0), Late(0.12, 0.06)
    times = made.settings.dt * np.arange(made.settings.horizon + 1)
    sent = np.array([np.interp(times, [0.0, s], [0.0, to]) for s, to in zip(late, (-0.1, 0.01), strict=True)])
    sent[1] += start[STEER]
    made.take_sent(sent, late)
    plan = made.cold_start(start, clock).z
    rates = made.settings.limits.drive_rate, made.settings.limits.steer_rate
    for row, acting, late_s, rate in zip(plan[[DRIVE, STEER]], sent, late, rates, strict=True):
        free = int(late_s / made.settings.dt) + 1
        np.testing.assert_allclose(row[:free], acting[:free], atol=1e-12)
        most = rate * (free * made.settings.dt - late_s)
        assert 0.0 < abs(row[free] - acting[free]) <= most + 1e-9, "the rest of the interval is free"
    made.take_sent(np.array([0.0 * sent[0], sent[1]]), late)
    coasting = made.cold_start(start, clock).z
    assert plan[VX, 3] < coasting[VX, 3] - 0.3, "brakes that are on their way slow the car"
    made.take_sent(0.0 * sent, AT_ONCE)
    np.testing.assert_array_equal(made.here, made.stages[:, 0])


@pytest.mark.parametrize("seed", range(3))
def test_rows_and_cost_gradient_agree_with_finite_differences(controller: Controller, seed: int) -> None:
    z, du = _perturbed(controller.sqp.z, controller.sqp.du, seed)
    base = _blocks(controller, z, du)
    cost, choice = controller.problem.reference_functions()
    k = 11 + seed

    def evaluate(state: np.ndarray) -> tuple[float, np.ndarray]:
        stage = controller.stages[:, k]
        theta_f, theta_r = choice(z[:, k + 1], stage, controller.common)
        value, rows, _, _ = cost(state, du[:, k], stage, controller.common, theta_f, theta_r)
        return float(value), np.array(rows).ravel()

    for i, h in enumerate([1e-3, 1e-3, 1e-5, 1e-4, 1e-4, 1e-5, 1e-3, 1e-6, 1e-6, 1e-4]):
        moved = np.zeros(NZ)
        moved[i] = h
        (high, rows_high), (low, rows_low) = evaluate(z[:, k + 1] + moved), evaluate(z[:, k + 1] - moved)
        assert base["q"][i, k] == pytest.approx((high - low) / (2 * h), rel=1e-4, abs=2e-4)
        np.testing.assert_allclose(base["C"][:, NZ * k + i], (rows_high - rows_low) / (2 * h), rtol=1e-4, atol=1e-5)


def test_contouring_and_lag_error_are_those_of_equation_5(controller: Controller) -> None:
    """A point 1.3 m right of and 0.7 m behind the reference point has e_c = 1.3 and e_l = 0.7."""
    import casadi as ca

    from planner.problem.mpcc import path_errors

    names, k = controller.problem.stage, 4
    s = controller.sqp.z[S, k + 1]
    point = controller.reference.at(np.array([s]))
    heading = point.heading[0]
    forward, left = np.array([np.cos(heading), np.sin(heading)]), np.array([-np.sin(heading), np.cos(heading)])
    z = np.zeros(NZ)
    z[:2] = np.array([point.x[0], point.y[0]]) - 0.7 * forward - 1.3 * left
    z[S] = s
    stage = {name: ca.DM(controller.stages[names[name], k]) for name in ("s", "cubic_x", "cubic_y")}
    contouring, lag = path_errors(ca.DM(z), stage)
    assert (float(contouring), float(lag)) == pytest.approx((1.3, 0.7), abs=1e-9)


def test_edge_zone_is_felt_on_both_sides_and_only_near_the_edge() -> None:
    straight = {"s": 0.0, "cubic_x": ca.DM([0, 1, 0, 0]), "cubic_y": ca.DM.zeros(4)}
    road = {**straight, "centre": ca.DM([1.0, 0.0]), "half_width": 5.0}

    def felt(y: float) -> float:
        z = ca.DM(NZ, 1)
        z[1] = y
        return float(into_zone(z, road, 0.35))

    assert max(felt(1.0), felt(4.0), felt(-2.0)) < 0.002
    assert felt(5.85) == pytest.approx(0.2, abs=0.01)
    assert felt(-3.85) == pytest.approx(0.2, abs=0.01)
    assert felt(6.5) == pytest.approx(0.85, abs=0.01), "and beyond the edge"


def test_hessian_blocks_are_positive_definite(controller: Controller) -> None:
    base = _blocks(controller, controller.sqp.z, controller.sqp.du)
    for k in range(controller.settings.horizon):
        assert np.linalg.eigvalsh(base["Q"][:, NZ * k : NZ * (k + 1)])[0] > 0
        assert np.linalg.eigvalsh(base["R"][:, NU * k : NU * (k + 1)])[0] > 0


def test_sqp_steps_contract_to_a_fixed_point(controller: Controller) -> None:
    z0 = controller.sqp.z[:, 0].copy()
    norms = [controller.solve(z0, clock, 1).step_norm for _ in range(12)]
    assert norms[-1] < 5e-3


def test_converged_sqp_has_the_cost_and_inputs_of_ipopt(controller: Controller) -> None:
    z0 = controller.sqp.z[:, 0].copy()
    for _ in range(25):
        solution = controller.solve(z0, clock, 1)
    result = ReferenceNlp(controller).solve(z0, solution.z, solution.du, clock)
    assert result.converged
    bounds = np.array(controller.problem.change_bounds())[:, None]
    # the last change of v_s earns nothing (no terminal progress) and is left free
    difference = np.abs((result.du - solution.du) / bounds)[:, :-1]
    assert difference[1].max() < 0.03
    assert difference.max() < 0.15
    np.testing.assert_allclose(result.z[:6], solution.z[:6], atol=0.1)


def test_plain_problem_does_not_depend_on_the_belief_of_information(controller: Controller) -> None:
    """q_I = 0 is exactly the plain MPCC: no row, no cost, whatever the information settings say."""
    other = replace(
        declared_settings(load_car()),
        information=replace(declared_settings(load_car()).information, bound=1.0, criterion="log_det"),
    )
    twin, _ = bench_controller(load_track(), load_car().vehicle, other)
    assert twin.problem.rows == controller.problem.rows
    z0 = start_state(controller, 620.0)
    a, b = controller.cold_start(z0, clock), twin.cold_start(z0, clock)
    np.testing.assert_array_equal(a.du, b.du)


def test_start_from_standstill_pulls_away(controller: Controller) -> None:
    z0 = start_state(controller, 0.0)
    z0[VX] = z0[PROGRESS] = 0.0
    solution = controller.cold_start(z0, clock)
    assert solution.usable
    assert solution.z[VX, -1] > 8.0
    assert np.all(np.diff(solution.z[VX]) > -1e-3)


def test_literal_load_limit_is_the_signed_sum_of_equation_10() -> None:
    literal, _ = bench_controller(
        load_track(),
        load_car().vehicle,
        replace(declared_settings(load_car()), load_limit="literal"),
        compiled=False,
    )
    solution = literal.cold_start(start_state(literal, 620.0), clock)
    assert solution.usable
    base = _blocks(literal, literal.sqp.z, literal.sqp.du)
    from planner.plan.acceptance import AcceptanceCheck
    from planner.plan.checks import Roadside, bounds_of, plan_of

    bounds = bounds_of(literal.settings, literal.knowledge.load_max, 0.0)
    check = AcceptanceCheck(literal.checked, literal.knowledge.theta, np.zeros(0), 1.0)
    front, _ = check(plan_of(solution, Roadside(literal.reference.line)), bounds).shares
    row = np.abs(1.0 - base["upper_row"][1])
    # the row holds at the worst sigma point, so it is never below the share at the mean
    assert np.all(row >= front[1:] - 0.02)


def test_half_of_a_step_lies_between_the_guess_and_the_solution(controller: Controller) -> None:
    sqp, z0 = controller.sqp, controller.sqp.z[:, 0].copy()
    z0[4] += 0.3
    before, du = sqp.z.copy(), sqp.du.copy()
    before[:, 0] = z0
    solution = controller.solve(z0, lambda: 0, 1)
    assert solution.usable
    sqp.halve_step()
    np.testing.assert_allclose(sqp.z, 0.5 * (before + solution.z))
    np.testing.assert_allclose(sqp.du, 0.5 * (du + solution.du))
    np.testing.assert_array_equal(sqp.z[:, 0], z0)
