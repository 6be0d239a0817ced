"""Sequential quadratic programming in real time: linearise, solve one QP, take the full step.

One iteration a control period from the shifted last solution (real-time iteration, Diehl et al. 2005), two with
information. Where there is a compiler, all of it is one call into a library generated for the problem (`fixed`); a QP
which that does not solve, and every QP without a compiler, goes to a QP solver on the arrays of the stage functions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from hil_gateway.process.arrays import Array
from planner.problem import infomax
from planner.problem.motion import BOUNDED, NU, NZ
from planner.problem.mpcc import OUTPUTS, Problem
from planner.solver.choice import make_qp_solver
from planner.solver.fixed import FixedSqp
from planner.solver.fixed_code import projected
from planner.solver.functions import Functions
from planner.solver.qp import QpSize, QpStatus, StageQp

Stopwatch = Callable[[], int]
"""nanoseconds, for measuring durations"""


@dataclass(frozen=True)
class Solution:
    """States (NZ, N+1) and changes (NU, N) of a solve; `information` is Delta I of stages 1..N, last linearisation."""

    status: QpStatus
    z: Array
    du: Array
    information: Array
    step_norm: float
    """largest scaled change of the inputs in the last iteration: how far from converged"""
    linearise_ns: int
    qp_ns: int
    qp_iterations: int

    @property
    def usable(self) -> bool:
        """Whether every iteration ended in a QP solution."""
        return self.status is QpStatus.SOLVED


@dataclass
class _Iterate:
    """A guess with the multipliers of its soft rows, and how it came about."""

    z: Array
    du: Array
    multiplier: Array
    information: Array = field(default_factory=lambda: np.zeros(0))
    status: QpStatus = QpStatus.SOLVED
    step: float = 0.0
    done: int = 0
    linearise_ns: int = 0
    qp_ns: int = 0
    qp_iterations: int = 0


@dataclass(frozen=True)
class Step:
    """What one solve is given: the guess with its multipliers, initial state, parameters, number of SQP iterations."""

    z: Array
    du: Array
    multiplier: Array
    z0: Array
    stages: Array
    common: Array
    iterations: int


class Sqp:
    """Solver of one `Problem`; holds the guess (`z`, `du`) from step to step.

    `observer`, where there is one, is given every step before it is solved.
    """

    def __init__(self, problem: Problem, functions: Functions, backend: str = "auto") -> None:
        self.problem = problem
        self.N = problem.settings.horizon
        self._horizon, self._step = functions.horizon, functions.step
        self._information = functions.information
        self._fixed = self._generated(functions, backend)
        self.qp = self._bind()
        self._solver = make_qp_solver(self.qp, "auto" if backend == "fixed" else backend)
        self.z, self.du = np.zeros((NZ, self.N + 1), order="F"), np.zeros((NU, self.N), order="F")
        self.multiplier = np.zeros((len(problem.rows), self.N), order="F")
        self._from = self.z, self.du
        """the guess the last solve began from"""
        self._loads = [problem.rows.index(name) for name in ("load_front", "load_rear")]
        self._bounds = np.array(problem.change_bounds())[:, None]
        self._project = projected(problem)
        self.observer: Callable[[Step], None] | None = None

    def _generated(self, functions: Functions, backend: str) -> FixedSqp | None:
        """The generated solver where it is wanted and there.

        Raises:
            RuntimeError: asked for by name, and not there.
        """
        if functions.library is not None and backend in ("auto", "fixed"):
            return FixedSqp(functions.library, self.problem)
        if backend == "fixed":
            raise RuntimeError("QP solver fixed is not usable: it needs a C compiler (hil doctor)")
        return None

    @property
    def backend(self) -> str:
        """QP solver and kind of stage functions, for reports."""
        first = "" if self._fixed is None else f"{self._fixed.name}, then "
        return f"{first}{self._solver.name}, stage functions {self._horizon.backend}"

    def _bind(self) -> StageQp:
        """A QP whose arrays are the outputs of the stage functions."""
        problem = self.problem
        qp = StageQp(QpSize(self.N, NZ, NU, BOUNDED, len(problem.rows)))
        for name, array in zip(OUTPUTS, self._horizon.outputs, strict=False):
            setattr(qp, name, array)
        qp.mask_lower[:] = problem.mask_lower
        for row, (l1, l2) in enumerate(problem.slack()):
            qp.slack_l1[row], qp.slack_l2[row] = l1, l2
        return qp

    def solve(self, z0: Array, stages: Array, common: Array, iterations: int, stopwatch: Stopwatch) -> Solution:
        """SQP iterations from the held guess with initial state `z0` (NZ,).

        `stages` (n, N) are the parameters of stages 1..N, `common` those of all stages (`Problem.common`).
        The guess becomes the solution when every QP was solved, and is left alone otherwise.
        """
        self._from = self.z, self.du
        if self.observer is not None:
            start = self._start(z0)
            guess = start.z, start.du, start.multiplier
            self.observer(Step(*guess, z0.copy(), stages.copy(order="F"), common.copy(), iterations))
        if self._fixed is None:
            result = self._start(z0)
        else:
            result = self._iterate_generated(z0, stages, common, iterations, stopwatch)
        if result.done < iterations:
            result = self._iterate(result, stages, common, iterations - result.done, stopwatch)
        if result.status is QpStatus.SOLVED:
            self.z, self.du, self.multiplier = result.z, result.du, result.multiplier
        return Solution(
            result.status, result.z, result.du, result.information, result.step, result.linearise_ns, result.qp_ns,
            result.qp_iterations,
        )  # fmt: skip

    def _start(self, z0: Array) -> _Iterate:
        """The held guess from initial state `z0`."""
        start = _Iterate(self.z.copy(order="F"), self.du.copy(order="F"), self.multiplier.copy(order="F"))
        start.z[:, 0] = z0
        return start

    def _iterate_generated(
        self, z0: Array, stages: Array, common: Array, iterations: int, stopwatch: Stopwatch
    ) -> _Iterate:
        """SQP iterations in the generated library, as far as its QPs are solved."""
        assert self._fixed is not None
        fixed, began = self._fixed, stopwatch()
        fixed.z[:], fixed.du[:], fixed.multiplier[:] = self.z, self.du, self.multiplier
        fixed.z[:, 0] = z0
        fixed.stages[:], fixed.common[:] = stages, common
        outcome = fixed.iterate(iterations)
        total = stopwatch() - began
        linearise = min(total, outcome.linearise_ns)
        return _Iterate(
            fixed.z.copy(order="F"), fixed.du.copy(order="F"), fixed.multiplier.copy(order="F"),
            fixed.information.copy(), outcome.status, outcome.step, outcome.iterations, linearise,
            total - linearise, outcome.qp_iterations,
        )  # fmt: skip

    def _iterate(
        self, start: _Iterate, stages: Array, common: Array, iterations: int, stopwatch: Stopwatch
    ) -> _Iterate:
        """SQP iterations with the QP solver, after those of the generated library."""
        now, arguments = replace(start, status=QpStatus.SOLVED), self._horizon.inputs
        arguments[3][:], arguments[4][:, 0] = stages, common
        for _ in range(iterations):
            began = stopwatch()
            arguments[3][self.problem.stage["multiplier"]] = now.multiplier[self._loads]
            arguments[0][:], arguments[1][:], arguments[2][:] = now.z[:, :-1], now.du, now.z[:, 1:]
            self._horizon()
            if self._project:
                self._add_projected_hessian()
            middle = stopwatch()
            now.status = self._solver.solve()
            now.linearise_ns, now.qp_ns = now.linearise_ns + middle - began, now.qp_ns + stopwatch() - middle
            now.qp_iterations += self._solver.iterations
            if now.status is not QpStatus.SOLVED:
                break
            now.z[:, 1:] += self.qp.dz
            now.du += self.qp.du
            now.multiplier = self.qp.multiplier.copy(order="F")
        now.step = float(np.max(np.abs(self.qp.du / self._bounds)))
        now.information = self._horizon.outputs[len(OUTPUTS)][0].copy()
        return now

    def _add_projected_hessian(self) -> None:
        """Reference convexification: exact Hessian of the information with negative eigenvalues cut off."""
        n = len(infomax.FORCE_STATES)
        exact = self._horizon.outputs[len(OUTPUTS) + 1].reshape(n, n, self.N, order="F").transpose(2, 0, 1)
        blocks = self.qp.Q.reshape(NZ, NZ, self.N, order="F")
        index = np.array(infomax.FORCE_STATES)
        blocks[index[:, None], index[None, :]] += infomax.project(exact).transpose(1, 2, 0)

    def horizon_information(self, common: Array) -> Array:
        """sum_k F_k of the guess in unscaled parameters, (n_theta, n_theta); only with information."""
        assert self._information is not None
        self._information.inputs[0][:], self._information.inputs[1][:, 0] = self.z[:, 1:], common
        self._information()
        n = self._information.outputs[0].shape[0]
        return np.asarray(self._information.outputs[0].reshape(n, n, self.N, order="F").sum(axis=2))

    def propagate(self, z: Array, du: Array, stage: Array, common: Array) -> Array:
        """z_next = F(z, du)."""
        for target, value in zip(self._step.inputs, (z, du, stage, common), strict=True):
            target[:, 0] = value
        self._step()
        return self._step.outputs[0][:, 0].copy()

    def shift(self, stage: Array, common: Array) -> None:
        """Move the guess one interval on; the last interval holds the inputs."""
        last = self.propagate(self.z[:, -1], np.zeros(NU), stage, common)
        # new arrays: the old ones belong to the solution handed out
        z, du = np.empty_like(self.z, order="F"), np.zeros_like(self.du, order="F")
        z[:, :-1], z[:, -1], du[:, :-1] = self.z[:, 1:], last, self.du[:, 1:]
        self.z, self.du = z, du
        self.multiplier[:, :-1] = self.multiplier[:, 1:]
        self.shift_multipliers()

    def solve_step(self, step: Step, stopwatch: Stopwatch) -> Solution:
        """Solve a recorded step; multipliers held from solves before stay a warm start, as in a drive."""
        self.z, self.du = step.z.copy(order="F"), step.du.copy(order="F")
        self.multiplier = step.multiplier.copy(order="F")
        return self.solve(step.z0, step.stages, step.common, step.iterations, stopwatch)

    def shift_multipliers(self) -> None:
        """Those the generated solver starts from, one interval on; for the next recorded step."""
        if self._fixed is not None:
            self._fixed.shift()

    def halve_step(self) -> None:
        """Take half of the last solve's step: full steps from two guesses may lead to each other for ever."""
        z, du = self._from
        half = 0.5 * (self.z + z)
        half[:, 0] = self.z[:, 0]  # where the car is
        self.z, self.du = half, 0.5 * (self.du + du)

    def set_guess(self, z: Array, du: Array) -> None:
        """Start from another trajectory (cold start, new model)."""
        self.z, self.du = np.asfortranarray(z), np.asfortranarray(du)
        self.multiplier[:] = 0.0
        if self._fixed is not None:
            self._fixed.forget()
