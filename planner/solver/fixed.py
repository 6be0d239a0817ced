"""Solver generated for one problem: fixed sizes, stage functions and QP in one C library (`fixed_code`).

Full-space Riccati-recursion interior point, predictor-corrector, warm-started by the multipliers of the last solution.
It needs a C compiler; without one, or where its self-test fails, another QP solver is used (`choice.make_qp_solver`).
"""

from __future__ import annotations

import ctypes
import warnings
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from hil_gateway.process.arrays import Array
from hil_gateway.process.compiled import compile_source, find_compiler
from planner.problem import infomax
from planner.problem.motion import BOUNDED, NU, NZ
from planner.problem.mpcc import OUTPUTS, Problem
from planner.solver.expressions import TranslationError
from planner.solver.fixed_code import blocks_source, problem_source
from planner.solver.pattern import ARRAYS, Pattern
from planner.solver.qp import QpSize, QpStatus, QpWarning, StageQp
from planner.solver.self_test import check

WIDTH = 4
"""stages side by side: four doubles fill a vector register of AVX2; eight gain 5 to 10 % on few processors"""

STATUS = (QpStatus.SOLVED, QpStatus.ITERATION_LIMIT, QpStatus.SMALL_STEP, QpStatus.NOT_FINITE)
"""the library's status codes"""


class _Report(ctypes.Structure):
    _fields_ = [
        ("status", ctypes.c_int32), ("iterations", ctypes.c_int32), ("qp_iterations", ctypes.c_int32),
        ("reserved", ctypes.c_int32), ("linearise_ns", ctypes.c_int64), ("qp_ns", ctypes.c_int64),
        ("step", ctypes.c_double),
    ]  # fmt: skip


@dataclass(frozen=True)
class SolveOutcome:
    """How a call of `FixedSqp.iterate` ended: status of the last QP, SQP iterations done, QP iterations, durations."""

    status: QpStatus
    iterations: int
    qp_iterations: int
    linearise_ns: int
    qp_ns: int
    step: float


class _Library:
    """The functions of one library, and working memory for one solver."""

    def __init__(self, path: Path) -> None:
        lib = ctypes.CDLL(str(path))
        lib.work_size.restype = ctypes.c_size_t
        self.solve_blocks, self.write_blocks, self.iterate_sqp = lib.solve_blocks, lib.write_blocks, lib.iterate_sqp
        self.shift, self.forget = lib.shift, lib.forget
        raw = ctypes.create_string_buffer(lib.work_size() + 64)
        self._keep = raw
        self.work = ctypes.c_void_p((ctypes.addressof(raw) + 63) // 64 * 64)


def _pointer(array: Array) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


def _pointers(arrays: list[Array | None]) -> Any:
    return (ctypes.c_void_p * len(arrays))(*(None if a is None else a.ctypes.data for a in arrays))


def build_library(problem: Problem) -> Path | None:
    """Library of a problem, from the cache or freshly built; None where there is no compiler.

    None with a warning where code cannot be generated, or does not answer as it must.
    """
    if find_compiler() is None:
        return None
    try:
        self_test()
        stage = problem.stage_function()
        path = compile_source(problem_source(problem, stage, WIDTH))
        if path is not None:
            _compare(FixedHorizon(path, problem), stage)
        return path
    except (TranslationError, OSError, RuntimeError) as error:
        text = f"generated solver is not usable ({error}); HPIPM takes 4 to 8 times as long"
        warnings.warn(text, QpWarning, stacklevel=2)
        return None


def _compare(horizon: FixedHorizon, stage: ca.Function) -> None:
    """Stage functions of the library against CasADi's virtual machine, at arbitrary arguments.

    Raises:
        RuntimeError: they differ.
    """
    rng, N = np.random.default_rng(0), horizon.inputs[0].shape[1]
    for array in horizon.inputs:
        array[:] = rng.uniform(0.5, 1.5, array.shape)
    horizon.inputs[0][:, 1:] = horizon.inputs[2][:, :-1]
    horizon()
    expected: Any = stage.map("expected", "serial", N, [4], [])(*horizon.inputs)
    for name, value, wanted in zip(stage.name_out(), horizon.outputs, expected, strict=True):
        if not np.allclose(value, np.array(wanted), rtol=1e-8, atol=1e-8 * (1.0 + float(ca.norm_inf(wanted)))):
            raise RuntimeError(f"self-test failed: block {name} differs from CasADi's")


class FixedSqp:
    """SQP iterations of one problem in one library; holds the multipliers of its last QP from call to call."""

    name = "fixed"

    def __init__(self, path: Path, problem: Problem) -> None:
        N, self._lib = problem.settings.horizon, _Library(path)
        self.z, self.du = np.zeros((NZ, N + 1), order="F"), np.zeros((NU, N), order="F")
        self.stages = np.zeros((problem.stage.size, N), order="F")
        self.common = np.zeros(problem.common.size)
        self.multiplier = np.zeros((len(problem.rows), N), order="F")
        self.information = np.zeros(N)
        self._report = _Report()
        arrays = (self.z, self.du, self.stages, self.common, self.multiplier, self.information)
        self._arguments = (*map(_pointer, arrays), ctypes.byref(self._report))

    def iterate(self, iterations: int) -> SolveOutcome:
        """SQP iterations from the guess in `z`, `du`, `multiplier`, in place; parameters are in `stages`, `common`."""
        self._lib.iterate_sqp(self._lib.work, ctypes.c_int32(iterations), *self._arguments)
        r = self._report
        return SolveOutcome(STATUS[r.status], r.iterations, r.qp_iterations, r.linearise_ns, r.qp_ns, r.step)

    def shift(self) -> None:
        """The held multipliers one stage on."""
        self._lib.shift(self._lib.work)

    def forget(self) -> None:
        """The next QP starts afresh."""
        self._lib.forget(self._lib.work)


class FixedHorizon:
    """The library's stage functions in the form of a `CompiledFunction`: blocks of the QP for another solver.

    `inputs`: z of stages 0..N-1, du, z of stages 1..N, stage and common parameters; `outputs` as `mpcc.OUTPUTS`, then
    information and its exact Hessian.
    """

    backend = "compiled, four stages at a time"

    def __init__(self, path: Path, problem: Problem) -> None:
        N, curved = problem.settings.horizon, len(infomax.FORCE_STATES)
        self._lib = _Library(path)
        shapes = ((NZ, N), (NU, N), (NZ, N), (problem.stage.size, N), (problem.common.size, 1))
        self.inputs = tuple(np.zeros(shape, order="F") for shape in shapes)
        qp = StageQp(QpSize(N, NZ, NU, BOUNDED, len(problem.rows)))
        extra = (np.zeros((1, N), order="F"), np.zeros((curved, curved * N), order="F"))
        self.outputs: tuple[Array, ...] = (*(getattr(qp, name) for name in OUTPUTS), *extra)
        self._z = np.zeros((NZ, problem.settings.horizon + 1), order="F")
        self._multiplier = np.zeros((len(problem.rows), problem.settings.horizon), order="F")
        first = problem.stage["multiplier"].start
        self._coupled = slice(first, first + 2), [problem.rows.index(r) for r in ("load_front", "load_rear")]
        blocks = dict(zip(OUTPUTS, self.outputs, strict=False))
        self._blocks = _pointers([blocks.get(name) for name in ARRAYS])
        guess = (self._z, self.inputs[1], self.inputs[3], self.inputs[4], self._multiplier)
        self._arguments = (*map(_pointer, guess), self._blocks, *map(_pointer, self.outputs[len(OUTPUTS) :]))

    def __call__(self) -> None:
        """Evaluate from `inputs` into `outputs`."""
        self._z[:, :-1], self._z[:, -1] = self.inputs[0], self.inputs[2][:, -1]
        self._multiplier[self._coupled[1]] = self.inputs[3][self._coupled[0]]
        self._lib.write_blocks(self._lib.work, *self._arguments)


class FixedQpSolver:
    """The interior point alone on a `StageQp`: its pattern is dense unless given."""

    name = "fixed"

    def __init__(self, qp: StageQp, pattern: Pattern | None = None, *, warm: bool = False) -> None:
        pattern = pattern or Pattern.dense(qp.size, qp.mask_lower, qp.mask_upper)
        path = compile_source(blocks_source(pattern, WIDTH))
        if path is None:
            raise RuntimeError("no C compiler")
        self._lib, self._warm, self.iterations = _Library(path), warm, 0
        arrays = [getattr(qp, name) for name in (*ARRAYS, "dz", "du", "multiplier")]
        self._arrays, self._keep, self._count = _pointers(arrays), arrays, ctypes.c_int32()

    def solve(self) -> QpStatus:
        """Read the data, write `dz`, `du` and `multiplier`; they are meaningful only if the result is SOLVED."""
        if not self._warm:
            self._lib.forget(self._lib.work)
        status = self._lib.solve_blocks(self._lib.work, self._arrays, ctypes.byref(self._count))
        self.iterations = self._count.value
        return STATUS[status]


@cache
def self_test() -> None:
    """Solve a small QP of known optimum.

    Raises:
        RuntimeError: the generated code answers wrongly, or cannot be built.
        OSError: the library cannot be loaded.
    """
    check(FixedQpSolver)
