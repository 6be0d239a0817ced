"""Information in the planner: exact gradients, convex Hessians, D-criterion weights and sigma points."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from benchmarks.plans.bench import bench_controller, clock, start_state
from hil_gateway.car.car import load_car
from hil_gateway.track.loading import load_track
from planner.plan.acceptance import AcceptanceCheck
from planner.plan.checks import Roadside, bounds_of, plan_of
from planner.plan.controller import Controller
from planner.problem import infomax
from planner.problem.infomax import (
    CAUTION,
    FADE,
    FORCE_STATES,
    PATIENCE_S,
    caution,
    independent_samples,
    least_of,
    patience,
    project,
    relative_spread,
    scheduled_weight,
    sigma_points,
)
from planner.problem.motion import NU, NZ
from planner.problem.settings import Information, declared_settings

WEIGHT = 0.01


def _controller(compiled: bool = True, **changes: object) -> Controller:
    settings = replace(declared_settings(load_car()), information=replace(Information(weight=WEIGHT), **changes))
    return bench_controller(load_track(), load_car().vehicle, settings, compiled=compiled)[0]


@pytest.fixture(scope="module")
def controller() -> Controller:
    made = _controller()
    made.cold_start(start_state(made, 620.0), clock)
    return made


def _terms(controller: Controller) -> ca.Function:
    problem = controller.problem
    z, _, stage_vector, _, common, p = problem._symbols()
    terms = infomax.cost_terms(problem, z, p)
    value = infomax.weighted_gain(problem, z, p)
    return ca.Function(
        "terms", [z, stage_vector, common], [value, terms.gradient, terms.hessian, terms.exact_hessian, terms.gain]
    )


def _at(controller: Controller, f: ca.Function, z: np.ndarray) -> list[np.ndarray]:
    return [np.array(v) for v in f(z, controller.stages[:, 3], controller.common)]


@pytest.mark.promise("N2")
@pytest.mark.parametrize("k", [2, 15, 30])
def test_information_gradient_and_hessian_are_exact(controller: Controller, k: int) -> None:
    f, z = _terms(controller), controller.sqp.z[:, k]
    q_information = controller.common[controller.problem.common["q_information"]]
    weight = float((q_information * controller.stages[controller.problem.stage["learning"], 3]).item())
    _, gradient, _, exact, _ = _at(controller, f, z)
    for a, i in enumerate(FORCE_STATES):
        h = np.zeros(NZ)
        h[i] = 1e-4 if i < 6 else 1e-6
        high, low = _at(controller, f, z + h), _at(controller, f, z - h)
        value = -weight * (high[0] - low[0]).item() / (2 * h[i])
        assert gradient[i].item() == pytest.approx(value, rel=1e-4, abs=1e-6)
        column = (high[1] - low[1])[list(FORCE_STATES), 0] / (2 * h[i])
        np.testing.assert_allclose(exact[:, a], column, rtol=2e-3, atol=1e-4 * np.abs(exact).max())


@pytest.mark.parametrize("kind", ["tyre_force", "imu_yaw"])
def test_abs_convexification_is_convex_and_of_the_exact_curvature(kind: str) -> None:
    """Along each of d, alpha_f, alpha_r alone its curvature is the magnitude of the exact one."""
    controller = _controller(compiled=False, kind=kind)
    controller.cold_start(start_state(controller, 620.0), clock)
    f = _terms(controller)
    for k in (2, 15, 30):
        _, _, hessian, exact, _ = _at(controller, f, controller.sqp.z[:, k])
        block = hessian[np.ix_(FORCE_STATES, FORCE_STATES)]
        assert np.linalg.eigvalsh(block)[0] > -1e-6 * np.abs(block).max()
        drive = np.array([0.0, 0.0, 0.0, 1.0, 0.0])
        assert drive @ block @ drive == pytest.approx(abs(drive @ exact @ drive), rel=1e-6)


def test_projection_is_the_nearest_convex_matrix() -> None:
    rng = np.random.default_rng(0)
    roots = rng.standard_normal((20, 5, 5))
    symmetric = roots + np.swapaxes(roots, 1, 2)
    projected = project(symmetric)
    assert np.linalg.eigvalsh(projected).min() > -1e-10
    convex = roots @ np.swapaxes(roots, 1, 2)
    np.testing.assert_allclose(project(convex), convex, atol=1e-9)
    # the remainder is negative semi-definite and orthogonal to what is kept (Higham, 1988)
    rest = symmetric - projected
    assert np.linalg.eigvalsh(rest).max() < 1e-10
    np.testing.assert_allclose(np.einsum("kij,kij->k", rest, projected), 0.0, atol=1e-9)


def test_projected_hessian_reaches_the_qp() -> None:
    exact, plain = (
        bench_controller(
            load_track(),
            load_car().vehicle,
            replace(declared_settings(load_car()), information=information),
            backend="hpipm",
        )[0]
        for information in (Information(weight=WEIGHT, convexification="projection"), Information(weight=WEIGHT))
    )
    for made in (exact, plain):
        made.cold_start(start_state(made, 620.0), clock)
        made.solve(made.sqp.z[:, 0].copy(), clock, 1)
    assert np.abs(exact.sqp.qp.Q - plain.sqp.qp.Q).max() > 1e-6
    for k in range(exact.settings.horizon):
        assert np.linalg.eigvalsh(exact.sqp.qp.stage(exact.sqp.qp.Q, k))[0] > 0


def test_both_convexifications_drive_alike() -> None:
    """Over a second of closed loop the exact Hessian with projection and `abs` choose nearly the same inputs."""
    traces = []
    for convexification in ("abs", "projection"):
        made = _controller(convexification=convexification)
        z = start_state(made, 620.0)
        made.cold_start(z, clock)
        states = []
        for _ in range(20):
            assert made.solve(z, clock).usable
            z = made.sqp.propagate(z, made.sqp.du[:, 0], made.stages[:, 0], made.common)
            made.shift()
            states.append(z)
        traces.append(np.array(states))
    assert np.abs(traces[0][:, :2] - traces[1][:, :2]).max() < 0.3
    assert np.abs(traces[0][:, 8] - traces[1][:, 8]).max() < 0.03


def test_information_weight_buys_information(controller: Controller) -> None:
    z0 = start_state(controller, 620.0)
    gains = []
    for weight in (1e-6, 0.03):
        made = _controller(weight=weight)
        gains.append(made.cold_start(z0, clock).information.sum())
    assert gains[1] > 1.02 * gains[0]


def test_information_row_holds_the_gain_below_its_bound() -> None:
    free, held = _controller(), _controller(compiled=False, bound=150.0)
    z0 = start_state(free, 620.0)
    assert free.cold_start(z0, clock).information.max() > 160.0
    assert held.cold_start(z0, clock).information.max() < 155.0


def test_what_exploring_counts_on_is_worked_out_once_for_a_guess_and_a_belief() -> None:
    """So that a plan finds it ready."""
    controller = _controller(criterion="log_det")
    controller.cold_start(start_state(controller, 620.0), clock)
    weights, found = controller.problem.common["information_weight"], []
    for belief in (1.0, 1.0, 0.25):
        controller.set_knowledge(replace(controller.knowledge, covariance=belief * controller.knowledge.covariance))
        controller.prepare()
        plain, controller.sqp.horizon_information = controller.sqp.horizon_information, _never
        controller._weigh_information(40.0)
        controller.sqp.horizon_information = plain
        found.append(controller.common[weights].copy())
    assert not np.array_equal(found[0], found[1]), "the guess has moved on"
    assert np.abs(found[2]).max() < 0.8 * np.abs(found[1]).max()


def _never(common: np.ndarray) -> np.ndarray:
    raise AssertionError("worked out again")


def test_d_criterion_weight_is_the_gradient_of_log_det() -> None:
    controller = _controller(criterion="log_det")
    controller.cold_start(start_state(controller, 620.0), clock)
    controller._weigh_information(40.0)
    k, n = controller.knowledge, len(controller.knowledge.mean)
    W = controller.common[controller.problem.common["information_weight"]].reshape(n, n)
    counted = independent_samples(controller.settings.dt)
    F, precision = counted * controller.sqp.horizon_information(controller.common), np.linalg.inv(k.covariance)
    scale = np.diag(k.mean)
    rng = np.random.default_rng(1)
    root = rng.standard_normal((n, n))
    dF = np.linalg.inv(scale) @ root @ root.T @ np.linalg.inv(scale)
    # in relative units, so that C_x (1e4 N) does not spoil the finite difference
    total = scale @ (precision + F) @ scale
    change = scale @ dF @ scale
    h = 1e-4
    difference = (np.linalg.slogdet(total + h * change)[1] - np.linalg.slogdet(total - h * change)[1]) / (2 * h)
    assert np.trace(W @ dF) == pytest.approx(difference, rel=1e-4)


def test_no_choice_within_the_stated_sigma_has_less_peak_than_the_least() -> None:
    rng, level, indices = np.random.default_rng(5), 2.0, (1, 2, 3)
    mean, root = rng.uniform(2.0, 3.0, 5), 0.05 * rng.standard_normal((5, 5))
    covariance = root @ root.T
    least = least_of(mean, covariance, indices, 3, level)
    marginal, away = covariance[1:4, 1:4], least[1:4] - mean[1:4]
    assert np.sqrt(away @ np.linalg.solve(marginal, away)) == pytest.approx(level)
    directions = rng.standard_normal((3, 2000))
    choices = mean[1:4, None] + level * np.linalg.cholesky(marginal) @ (directions / np.linalg.norm(directions, axis=0))
    assert least[3] <= choices[2].min()
    assert least[3] < sigma_points(mean, covariance, indices, level)[3].min() - 0.01, "no single axis goes as far"
    np.testing.assert_array_equal(least[[0, 4]], mean[[0, 4]])


def test_sigma_points_reproduce_the_belief() -> None:
    rng = np.random.default_rng(2)
    mean = rng.uniform(1.0, 2.0, 7)
    root = 0.02 * rng.standard_normal((7, 7))
    covariance = root @ root.T
    points = sigma_points(mean, covariance, (1, 2, 3), 1.0)
    assert points.shape == (7, 7)
    np.testing.assert_array_equal(points[:, 0], mean)
    np.testing.assert_allclose(points.mean(axis=1), mean, atol=1e-12)
    spread = (points[1:4] - mean[1:4, None]) @ (points[1:4] - mean[1:4, None]).T / 2
    np.testing.assert_allclose(spread, covariance[1:4, 1:4], atol=1e-12)
    np.testing.assert_array_equal(points[[0, 4, 5, 6]], np.repeat(mean[[0, 4, 5, 6], None], 7, axis=1))


def test_load_rows_hold_at_every_sigma_point(controller: Controller) -> None:
    """Eq. (10) for each choice of theta, over its own peak, by the equations of acceptance at each sigma point."""
    solution = controller.solve(controller.sqp.z[:, 0].copy(), clock, 10)
    plan, k = plan_of(solution, Roadside(controller.reference.line)), controller.knowledge
    level = controller.settings.sigma_level
    names = [p.name for p in controller.problem.model.tyre_table]
    for row, indices in enumerate(controller.problem.model.load_rows):
        weakest = least_of(k.mean, k.covariance, indices, names.index(("df", "dr")[row]), level)
        for theta in (*sigma_points(k.mean, k.covariance, indices, level).T, weakest):
            limits = [asked * theta[names.index(d)] for asked, d in zip(k.load_asked, ("df", "dr"), strict=True)]
            bounds = bounds_of(controller.settings, (limits[0], limits[1]), 0.0)
            assert (
                np.max(AcceptanceCheck(controller.checked, theta, np.zeros(0), 1.0)(plan, bounds).shares[row, 1:])
                < 1.02
            )
    assert solution.du.shape == (NU, controller.settings.horizon)


def test_a_stage_counts_for_as_many_samples_as_the_belief_will_count() -> None:
    assert independent_samples(0.05) == pytest.approx(5 / 50)


def test_exploring_fades_out_towards_its_goal_and_is_shut_below_learning_speed() -> None:
    assert scheduled_weight(8.0, 40.0, spread=0.5, goal=0.1) == 8.0
    assert scheduled_weight(8.0, 40.0, spread=0.1 * (1.0 + FADE) / 2.0, goal=0.1) == pytest.approx(4.0)
    assert scheduled_weight(8.0, 40.0, spread=0.09, goal=0.1) == 0.0
    assert scheduled_weight(8.0, 40.0, spread=1e-6, goal=0.0) == 8.0, "no goal: never ends"
    assert scheduled_weight(8.0, 10.0, spread=0.5, goal=0.1) == 0.0


def test_information_counts_less_the_later_it_comes() -> None:
    share = patience(0.05, 40)
    assert share[0] == 1.0
    assert np.all(np.diff(share) < 0)
    assert share[12] == pytest.approx(np.exp(-0.6 / PATIENCE_S))


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_a_plan_pays_for_information_in_proportion(share: float) -> None:
    controller = _controller()
    controller._weigh_information(40.0, share)
    assert controller.common[controller.problem.common["q_information"]] == pytest.approx(share * WEIGHT)


def test_a_slalom_leaves_some_of_the_load_limits_alone() -> None:
    controller = _controller()
    asked = np.array(controller.knowledge.load_asked)
    controller._weigh_information(40.0)
    assert controller.common[controller.problem.common["load_max"]] == pytest.approx(0.9 * asked)
    controller._weigh_information(40.0, 0.0)
    assert controller.common[controller.problem.common["load_max"]] == pytest.approx(asked)


def test_where_least_is_known_information_is_paid_less_for_than_it_promises() -> None:
    assert caution(CAUTION) == 1.0
    assert caution(1.0) == pytest.approx(CAUTION)
    assert caution(0.1) == pytest.approx(2.0)
    assert caution(0.0) == caution(0.01) < 5.0


def test_spread_is_the_geometric_mean_over_directions() -> None:
    prior = np.array([2.0, 0.5])
    assert relative_spread(np.diag((np.array([0.1, 0.4]) * prior) ** 2), prior) == pytest.approx(0.2)
    assert relative_spread(np.zeros((2, 2)), prior) == 0.0
