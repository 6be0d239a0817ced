"""QP solvers: same optimum as each other, soft rows one- and two-sided, and a fallback order that announces itself."""

from __future__ import annotations

import numpy as np
import pytest

from planner.solver import hpipm
from planner.solver import self_test as known
from planner.solver.choice import make_qp_solver
from planner.solver.hpipm import HpipmSolver, self_test
from planner.solver.qp import QpSize, QpStatus, QpWarning, StageQp, objective, violation
from planner.solver.qp_sparse import PiqpSolver


def random_qp(seed: int, N: int = 12) -> StageQp:
    """Stable random system with tight input bounds and soft rows, some of which cannot be met."""
    rng = np.random.default_rng(seed)
    problem = StageQp(QpSize(N, 4, 2, (1, 3), 2))
    for k in range(N):
        problem.stage(problem.A, k)[:] = 0.9 * np.eye(4) + 0.1 * rng.standard_normal((4, 4))
        problem.stage(problem.B, k)[:] = 0.3 * rng.standard_normal((4, 2))
        root = rng.standard_normal((4, 4))
        problem.stage(problem.Q, k)[:] = root @ root.T + 0.1 * np.eye(4)
        problem.stage(problem.R, k)[:] = np.diag([0.2, 0.1])
        problem.stage(problem.C, k)[:] = rng.standard_normal((2, 4))
    problem.b[:] = 0.2 * rng.standard_normal((4, N))
    problem.q[:], problem.r[:] = rng.standard_normal((4, N)), rng.standard_normal((2, N))
    problem.lower_z[:], problem.upper_z[:] = -4.0, 4.0
    problem.lower_u[:], problem.upper_u[:] = -0.8, 0.8
    problem.lower_row[:], problem.upper_row[:] = -0.3, 0.3
    problem.slack_l1[:], problem.slack_l2[:] = 2.0, 5.0
    problem.mask_lower[:] = (1.0, 0.0)
    return problem


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("stages", [3, 12])
def test_hpipm_finds_the_optimum_of_an_independent_solver(seed: int, stages: int) -> None:
    problem = random_qp(seed)
    assert PiqpSolver(problem).solve() is QpStatus.SOLVED
    best, step = objective(problem), problem.du.copy()
    assert HpipmSolver(problem, stages).solve() is QpStatus.SOLVED
    assert violation(problem) < 1e-3
    assert objective(problem) == pytest.approx(best, rel=2e-3, abs=5e-3)
    np.testing.assert_allclose(problem.du, step, atol=5e-2)


@pytest.mark.parametrize("solver", [HpipmSolver, PiqpSolver])
def test_multipliers_of_soft_rows_satisfy_stationarity(solver: type) -> None:
    """With one state row active at the end only, the multiplier equals the L1 + L2 price of its slack."""
    problem = random_qp(3)
    assert solver(problem).solve() is QpStatus.SOLVED
    for k in range(problem.size.N):
        excess = problem.stage(problem.C, k) @ problem.dz[:, k] - problem.upper_row[:, k]
        for row, value in enumerate(excess):
            if value > 1e-2:
                price = problem.slack_l1[row, k] + problem.slack_l2[row, k] * value
                assert problem.multiplier[row, k] == pytest.approx(price, rel=0.02, abs=0.05)
            if value < -5e-2:
                assert problem.multiplier[row, k] == pytest.approx(0.0, abs=0.05)


def test_data_that_is_not_finite_is_never_a_solution() -> None:
    problem = random_qp(0)
    problem.stage(problem.A, 4)[1, 2] = np.nan
    assert HpipmSolver(problem).solve() is not QpStatus.SOLVED


def test_solver_recovers_after_bad_data() -> None:
    problem = random_qp(1)
    solver = HpipmSolver(problem)
    assert solver.solve() is QpStatus.SOLVED
    good, first = problem.du.copy(), problem.b.copy()
    problem.b[:] = np.nan
    assert solver.solve() is not QpStatus.SOLVED
    problem.b[:] = first
    assert solver.solve() is QpStatus.SOLVED
    np.testing.assert_allclose(problem.du, good, atol=1e-9)


def test_a_library_that_answers_wrongly_fails_its_self_test(monkeypatch: pytest.MonkeyPatch) -> None:
    self_test.cache_clear()
    monkeypatch.setattr(known, "OPTIMUM", 8.0)
    with pytest.raises(RuntimeError, match="self-test"):
        self_test()
    problem = random_qp(0)
    with pytest.warns(QpWarning, match="hpipm is not usable"):
        solver = make_qp_solver(problem)
    assert solver.name == "piqp"
    self_test.cache_clear()


def test_missing_library_falls_back_with_its_cost(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing() -> None:
        raise OSError("libhpipm.so: cannot open shared object file")

    self_test.cache_clear()
    monkeypatch.setattr(hpipm, "_library", missing)
    with pytest.warns(QpWarning, match="times slower"):
        assert make_qp_solver(random_qp(0)).name == "piqp"
    self_test.cache_clear()


def test_unknown_backend_is_refused() -> None:
    with pytest.raises(ValueError, match="unknown QP backend"):
        make_qp_solver(random_qp(0), "magic")
