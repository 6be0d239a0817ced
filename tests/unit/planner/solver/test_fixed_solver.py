"""The generated solver: optima of independent solvers, bounded and honest on bad QPs, the same drive as with HPIPM."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.plans.bench import bench_controller, clock, drive, start_state
from benchmarks.plans.disturbed import FirstSolverOnly, solved
from benchmarks.plans.recorded import load, record, save
from estimator.belief.revision import declared_revision, model_of
from estimator.model.parameters import tyre_prior
from hil_gateway.car.car import load_car
from hil_gateway.process.compiled import compile_source, find_compiler
from hil_gateway.process.errors import InputError
from hil_gateway.track.loading import load_track
from planner.plan.controller import Controller
from planner.problem.motion import VX
from planner.problem.mpcc import Problem
from planner.problem.settings import Information, declared_settings
from planner.solver import choice, fixed, functions, sqp
from planner.solver import self_test as known
from planner.solver.choice import solvers_here
from planner.solver.fixed import FixedHorizon, FixedQpSolver, SolveOutcome, build_library
from planner.solver.pattern import Pattern
from planner.solver.qp import QpSize, QpStatus, QpWarning, StageQp, objective, violation
from planner.solver.qp_sparse import PiqpSolver

pytestmark = pytest.mark.skipif(find_compiler() is None, reason="no C compiler")

HORIZON = 7
"""not a multiple of the lanes: the last group of stages is part empty"""
SIZE = QpSize(HORIZON, 4, 2, (1, 3), 2)
LANES = Path(fixed.__file__).with_name("lanes.h")


def random_qp(seed: int, scale: float = 0.0, rank: int = 4, tight: float = 0.3) -> StageQp:
    """Stable random system with tight input bounds and soft rows; row 1 has no lower side.

    `scale`: decades over which states, inputs and rows are stretched; `rank` of Q; `tight`: width of the soft rows,
    negative where they cannot be met.
    """
    rng, qp = np.random.default_rng(seed), StageQp(SIZE)
    sz, su, sr = (10.0 ** rng.uniform(-scale, scale, n) for n in (4, 2, 2))
    for k in range(HORIZON):
        qp.stage(qp.A, k)[:] = (0.9 * np.eye(4) + 0.1 * rng.standard_normal((4, 4))) * np.outer(sz, 1 / sz)
        qp.stage(qp.B, k)[:] = 0.3 * rng.standard_normal((4, 2)) * np.outer(sz, 1 / su)
        root = rng.standard_normal((4, rank)) / sz[:, None]
        qp.stage(qp.Q, k)[:] = root @ root.T + 1e-6 * np.diag(1 / sz**2)
        qp.stage(qp.R, k)[:] = np.diag([0.2, 0.1] / su**2)
        qp.stage(qp.C, k)[:] = rng.standard_normal((2, 4)) * np.outer(sr, 1 / sz)
    qp.b[:] = 0.2 * rng.standard_normal((4, HORIZON)) * sz[:, None]
    qp.q[:], qp.r[:] = rng.standard_normal((4, HORIZON)) / sz[:, None], rng.standard_normal((2, HORIZON)) / su[:, None]
    qp.upper_z[:] = 6.0 * sz[[1, 3], None]
    qp.upper_u[:] = 0.8 * su[:, None]
    qp.upper_row[:] = tight * sr[:, None]
    qp.lower_z[:], qp.lower_u[:], qp.lower_row[:] = -qp.upper_z, -qp.upper_u, -np.abs(qp.upper_row)
    qp.slack_l1[:], qp.slack_l2[:] = 2.0 / sr[:, None], 5.0 / sr[:, None] ** 2
    qp.mask_lower[:] = (1.0, 0.0)
    return qp


def assert_optimal(qp: StageQp) -> None:
    """The step in `qp` keeps to the hard constraints and costs no more than PIQP's, but for the tolerance of 1e-4."""
    cost, over = objective(qp), violation(qp)
    du, products = qp.du.copy(), 2 * SIZE.N * (SIZE.nu + len(SIZE.bounded) + 2 * SIZE.rows)
    assert PiqpSolver(qp).solve() is QpStatus.SOLVED
    assert over < 1e-4 + violation(qp)
    # the duality gap is the sum of the products t lambda, each at most 1e-4
    assert cost - objective(qp) < 1e-4 * products + 1e-4 * abs(objective(qp))
    assert np.isfinite(du).all()


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from(["plain", "degenerate", "unmet", "scaled"]))
def test_optimum_is_that_of_an_independent_solver(seed: int, kind: str) -> None:
    """Strictly feasible; with Q of rank 1 and a soft row twice; with soft rows that cannot be met; badly scaled."""
    qp = {
        "plain": lambda: random_qp(seed),
        "degenerate": lambda: random_qp(seed, rank=1, tight=0.0),
        "unmet": lambda: random_qp(seed, tight=-3.0),
        "scaled": lambda: random_qp(seed, scale=1.5),
    }[kind]()
    if kind == "degenerate":
        qp.C[1], qp.upper_row[1] = qp.C[0], qp.upper_row[0]
    assert FixedQpSolver(qp).solve() is QpStatus.SOLVED
    assert_optimal(qp)


@pytest.mark.parametrize("width", [1, 2, 8])
def test_number_of_lanes_does_not_change_the_answer(width: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """One lane is the form for compilers without vectors."""
    qp = random_qp(5)
    assert FixedQpSolver(qp).solve() is QpStatus.SOLVED
    cost = objective(qp)
    monkeypatch.setattr(fixed, "WIDTH", width)
    assert FixedQpSolver(qp).solve() is QpStatus.SOLVED
    assert objective(qp) == pytest.approx(cost, abs=1e-3)
    assert violation(qp) < 1e-4


def test_sparse_pattern_and_dense_pattern_agree() -> None:
    qp = random_qp(6)
    keep = np.random.default_rng(1).random((4, 4)) < 0.5
    for k in range(HORIZON):
        qp.stage(qp.A, k)[:] *= keep | np.eye(4, dtype=bool)
        qp.stage(qp.C, k)[0, :2] = 0.0
    dense = Pattern.dense(SIZE, qp.mask_lower, qp.mask_upper)
    rows = dense.C.copy()
    rows[0, :2] = False
    assert FixedQpSolver(qp, dense).solve() is QpStatus.SOLVED
    step = qp.du.copy()
    assert FixedQpSolver(qp, replace(dense, A=keep | np.eye(4, dtype=bool), C=rows)).solve() is QpStatus.SOLVED
    np.testing.assert_allclose(qp.du, step, atol=1e-9)


@pytest.mark.parametrize("block", ["A", "B", "b", "Q", "q", "R", "r", "C", "upper_row", "lower_z", "upper_u"])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_numbers_that_are_none_are_never_a_solution_and_leave_no_trace(block: str, bad: float) -> None:
    qp = random_qp(7)
    solver = FixedQpSolver(qp, warm=True)
    array = getattr(qp, block)
    before = array.copy()
    array[:, 0] = bad
    status = solver.solve()
    assert status is not QpStatus.SOLVED or (np.isfinite(qp.du).all() and np.isinf(bad))
    array[:] = before
    FixedQpSolver(qp).solve()
    fresh = qp.du.copy()
    if status is not QpStatus.SOLVED:
        assert solver.solve() is QpStatus.SOLVED
        np.testing.assert_array_equal(qp.du, fresh)


def test_bounds_that_cannot_be_met_end_in_a_status() -> None:
    qp = random_qp(8)
    qp.lower_z[0, 3], qp.upper_z[0, 3] = 50.0, 51.0
    solver = FixedQpSolver(qp)
    assert solver.solve() in {QpStatus.ITERATION_LIMIT, QpStatus.SMALL_STEP, QpStatus.NOT_FINITE}
    assert solver.iterations <= 80


def test_same_qp_gives_the_same_bits() -> None:
    answers = []
    for _ in range(3):
        qp = random_qp(9)
        assert FixedQpSolver(qp).solve() is QpStatus.SOLVED
        answers.append(qp.du.copy())
    np.testing.assert_array_equal(answers[0], answers[1])
    np.testing.assert_array_equal(answers[0], answers[2])


FUNCTIONS: dict[str, tuple[Callable[[np.ndarray], np.ndarray], float]] = {
    "sin": (np.sin, 1e5), "cos": (np.cos, 1e5), "tan": (np.tan, 1.5), "atan": (np.arctan, 1e3),
    "tanh": (np.tanh, 30.0), "exp": (np.exp, 5.0), "sqrt": (np.sqrt, 1e3),
}  # fmt: skip


@pytest.mark.parametrize("width", [1, 4])
@pytest.mark.parametrize("name", FUNCTIONS)
def test_elementary_functions_keep_to_four_units_in_the_last_place(name: str, width: int) -> None:
    call = f"for (int k = 0; k < n; k += W) *(vec *)(y + k) = v_{name}(*(const vec *)(x + k));"
    source = f"#define W {width}\n{LANES.read_text()}\nvoid apply(const double *x, double *y, int n) {{ {call} }}\n"
    path = compile_source(source)
    assert path is not None
    exact, reach = FUNCTIONS[name]
    rng = np.random.default_rng(3)
    raw = np.concatenate([rng.uniform(-reach, reach, 4000), rng.uniform(-1, 1, 4000), [0.0, -0.0, np.nan, np.inf] * 2])
    room, out = np.zeros(len(raw) + 8), np.zeros(len(raw) + 8)
    x, y = (a[(-(a.ctypes.data // 8)) % 8 :][: len(raw)] for a in (room, out))
    x[:] = np.abs(raw) if name == "sqrt" else raw
    ctypes.CDLL(str(path)).apply(ctypes.c_void_p(x.ctypes.data), ctypes.c_void_p(y.ctypes.data), len(x))
    with np.errstate(invalid="ignore"):
        wanted = exact(x)
    finite = np.isfinite(x)
    largest = np.maximum(np.abs(wanted[finite]), 1.0 if name == "tanh" else 0.1)
    assert np.max(np.abs(y[finite] - wanted[finite]) / largest) < 4 * np.finfo(float).eps * (8 if name == "tan" else 1)
    assert np.isnan(y[np.isnan(x)]).all()


def _problem(**changes: Any) -> Problem:
    revised = model_of(declared_revision(tyre_prior(load_car(), "per_axle")), load_car().vehicle, 3000.0)
    return Problem(revised.model, replace(replace(declared_settings(load_car()), horizon=9), **changes))


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"load_limit": "literal"},
        {"information": Information(weight=0.01, kind="imu_yaw", convexification="projection")},
    ],
)
def test_stage_functions_are_those_of_casadi(changes: dict[str, Any]) -> None:
    """Every block of the QP of every stage, at arbitrary arguments."""
    problem = _problem(**changes)
    path = build_library(problem)
    assert path is not None
    horizon, rng = FixedHorizon(path, problem), np.random.default_rng(2)
    for array in horizon.inputs:
        array[:] = rng.uniform(0.4, 1.6, array.shape)
    horizon.inputs[0][:, 1:] = horizon.inputs[2][:, :-1]
    horizon()
    expected: Any = problem.horizon_function()(*horizon.inputs)
    for value, wanted in zip(horizon.outputs, expected, strict=True):
        np.testing.assert_allclose(value, np.array(wanted), rtol=1e-11, atol=1e-11)


def _controller(backend: str, **changes: Any) -> Controller:
    return bench_controller(
        load_track(), load_car().vehicle, replace(declared_settings(load_car()), **changes), backend=backend
    )[0]


@pytest.mark.parametrize("kind", ["plain", "abs", "projection"])
def test_closed_loop_is_that_of_hpipm(kind: str) -> None:
    """Ten seconds from the same start: the cars stay within 5 cm and 0.05 m/s of each other."""
    changes = {} if kind == "plain" else {"information": Information(weight=0.01, convexification=kind)}
    runs = [drive(_controller(backend, **changes), 1, steps=200) for backend in ("fixed", "hpipm")]
    a, b = (np.array(run.states) for run in runs)
    assert [run.qp_failures for run in runs] == [0, 0]
    np.testing.assert_allclose(a[:, :2], b[:, :2], atol=0.05)
    np.testing.assert_allclose(a[:, VX], b[:, VX], atol=0.05)


def test_disturbed_starts_are_solved_at_least_as_often_as_by_hpipm() -> None:
    """States off the plan by 3 m, 0.2 rad, 6 m/s and more, at their standard deviation."""
    controller = _controller("fixed")
    controller.cold_start(start_state(controller, 620.0), clock)
    steps = record(controller, 10)
    built = functions.build_functions(controller.problem)
    ours = FirstSolverOnly(controller.problem, built)
    hpipm = sqp.Sqp(controller.problem, replace(built, library=None), "hpipm")
    counts = [solved(one, steps, 1.0, range(60), clock)["solved"] for one in (ours, hpipm)]
    assert counts[0] >= counts[1]
    assert counts[0] >= 54


def test_multipliers_of_the_last_solution_save_iterations() -> None:
    """Twenty steps of a drive, each QP solved again without them: the same step, in at most 0.8 of the iterations."""
    controller = _controller("fixed")
    z, warm, cold = start_state(controller, 620.0), 0, 0
    controller.cold_start(z, clock)
    for _ in range(20):
        guess = controller.sqp.z.copy(), controller.sqp.du.copy(), controller.sqp.multiplier.copy()
        first = controller.solve(z, clock)
        controller.sqp.set_guess(*guess[:2])
        controller.sqp.multiplier[:] = guess[2]
        second = controller.solve(z, clock)
        assert first.usable
        assert second.usable
        np.testing.assert_allclose(first.z[:7], second.z[:7], atol=0.02)
        warm, cold = warm + first.qp_iterations, cold + second.qp_iterations
        z = controller.sqp.propagate(z, controller.sqp.du[:, 0], controller.stages[:, 0], controller.common)
        controller.shift()
    assert warm <= 0.8 * cold


def test_hpipm_takes_over_a_qp_that_is_not_solved(monkeypatch: pytest.MonkeyPatch) -> None:
    controller, other = _controller("auto"), _controller("hpipm")
    z = start_state(controller, 620.0)
    assert controller.sqp.backend.startswith("fixed, then hpipm")
    monkeypatch.setattr(
        sqp.FixedSqp, "iterate", lambda self, n: SolveOutcome(QpStatus.SMALL_STEP, 0, 3, 0, 0, 0.0), raising=True
    )
    solution, wanted = controller.cold_start(z, clock), other.cold_start(z, clock)
    assert solution.usable
    np.testing.assert_allclose(solution.z, wanted.z, atol=1e-9)


def test_without_a_compiler_hpipm_solves_with_interpreted_stages(monkeypatch: pytest.MonkeyPatch) -> None:
    controller = bench_controller(load_track(), load_car().vehicle, declared_settings(load_car()), compiled=False)[0]
    assert controller.sqp.backend == "hpipm, stage functions vm"
    with pytest.raises(RuntimeError, match="needs a C compiler"):
        bench_controller(
            load_track(), load_car().vehicle, declared_settings(load_car()), backend="fixed", compiled=False
        )


def test_generated_code_that_answers_wrongly_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    made_once = fixed.self_test, functions.libraries
    for made in made_once:
        made.cache_clear()
    monkeypatch.setattr(known, "OPTIMUM", 8.0)
    with pytest.warns(QpWarning, match="generated solver is not usable"):
        assert functions.build_functions(_problem()).library is None
    for made in made_once:
        made.cache_clear()


def test_recorded_steps_are_solved_again_as_they_were(tmp_path: Path) -> None:
    controller = _controller("hpipm")
    steps = record(controller, 12)
    save(tmp_path / "steps.npz", steps)
    again = load(tmp_path / "steps.npz")
    assert len(again) == 12
    first, second = (controller.sqp.solve_step(step, clock) for step in (steps[7], again[7]))
    np.testing.assert_array_equal(first.z, second.z)
    (tmp_path / "other.npz").write_bytes(b"no steps")
    with pytest.raises(InputError, match="not a file of recorded steps"):
        load(tmp_path / "other.npz")


def test_solver_named_by_the_command_is_the_one_that_plans(monkeypatch: pytest.MonkeyPatch) -> None:
    assert solvers_here().first == "fixed"
    monkeypatch.setattr(choice, "find_compiler", lambda: None)
    here = solvers_here()
    assert (here.first, here.second, here.lacks) == ("hpipm", "hpipm", "no C compiler")
