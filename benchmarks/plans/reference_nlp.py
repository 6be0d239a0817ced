"""The planner's problem as one nonlinear program for IPOPT: what the SQP method is compared with.

Same stages, soft rows and penalties; slacks are variables here. The functions run in CasADi's virtual machine
with exact second derivatives. Choices of theta in Eq. (10) are fixed at the guess, which spares IPOPT their cost.
"""

from __future__ import annotations

import contextlib
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from hil_gateway.process.arrays import Array
from hil_gateway.process.compiled import compile_source
from planner.plan.controller import Controller
from planner.problem.motion import BOUNDED, DRIVE, NU, NZ
from planner.solver.sqp import Stopwatch

TOLERANCE = 1e-4
WARM_MU = 1e-3
NLP_FLAGS = ("-O1", "-shared", "-fPIC")
"""megabytes of straight code: more optimisation takes minutes to build and gains little"""


@dataclass(frozen=True)
class NlpResult:
    """States (NZ, N+1), changes (NU, N), cost with soft penalties, duration and whether it converged."""

    z: Array
    du: Array
    cost: float
    solve_ns: int
    converged: bool


class ReferenceNlp:
    """IPOPT on the problem of a `Controller`, warm-started in primal and dual variables.

    `compiled`: functions and derivatives as C, which takes the compiler about a quarter of a minute, once.
    """

    def __init__(self, controller: Controller, *, compiled: bool = False) -> None:
        self._controller, self._compiled = controller, compiled
        problem, N = controller.problem, controller.settings.horizon
        self._shape = (N, NZ, NU, len(problem.rows))
        cost, choice = problem.reference_functions()
        step = problem.step_function()
        self._choice: Any = choice.map(N)
        self._solver = self._build(cost, step)
        self._duals: tuple[Array, Array] | None = None

    def _build(self, cost: ca.Function, step: ca.Function) -> Any:
        """Variables: z_1..N, du, slacks below and above each soft row; parameters: z_0 and all stage data."""
        N, nz, nu, rows = self._shape
        problem = self._controller.problem
        n_theta = len(problem.model.tyre_table)
        z, du = ca.MX.sym("z", nz, N), ca.MX.sym("du", nu, N)
        low, high = ca.MX.sym("low", rows, N), ca.MX.sym("high", rows, N)
        z0, stages = ca.MX.sym("z0", nz), ca.MX.sym("stages", problem.stage.size, N)
        common = ca.MX.sym("common", problem.common.size)
        theta = ca.MX.sym("theta", 2 * n_theta, N)
        every: Any = [ca.repmat(common, 1, N)]
        before = ca.horzcat(z0, z[:, :-1])
        after: Any = step.map(N)(before, du, stages, *every)
        costs, value, lower, upper = cost.map(N)(z, du, stages, *every, theta[:n_theta, :], theta[n_theta:, :])
        l1, l2 = (ca.repmat(ca.DM(list(v)), 1, N) for v in zip(*problem.slack(), strict=True))
        penalty = sum(ca.dot(l1, s) + 0.5 * ca.dot(l2, s * s) for s in (low, high))
        g = ca.vertcat(ca.vec(after - z), ca.vec(value - lower + low), ca.vec(upper - value + high))
        nlp: Any = {
            "x": ca.vertcat(ca.vec(z), ca.vec(du), ca.vec(low), ca.vec(high)),
            "p": ca.vertcat(z0, ca.vec(stages), common, ca.vec(theta)),
            "f": ca.sum2(costs) + penalty,
            "g": g,
        }
        options: Any = {
            "expand": not self._compiled, "print_time": False,
            "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.tol": TOLERANCE,
            "ipopt.warm_start_init_point": "yes", "ipopt.mu_init": WARM_MU, "ipopt.max_iter": 200,
            "ipopt.warm_start_bound_push": 1e-6, "ipopt.warm_start_mult_bound_push": 1e-6,
            "ipopt.warm_start_slack_bound_push": 1e-6, "ipopt.warm_start_bound_frac": 1e-6,
        }  # fmt: skip
        solver = ca.nlpsol("reference", "ipopt", nlp, options)
        return self._library(solver, options) if self._compiled else solver

    @staticmethod
    def _library(solver: Any, options: dict[str, Any]) -> Any:
        """The same solver on compiled functions.

        Raises:
            RuntimeError: there is no compiler.
        """
        with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
            source = Path(solver.generate_dependencies("reference.c")).read_text()
        path = compile_source(source, flags=NLP_FLAGS)
        if path is None:
            raise RuntimeError("no C compiler: IPOPT can only be had interpreted")
        kept = {name: value for name, value in options.items() if name != "expand"}
        return ca.nlpsol("reference", "ipopt", str(path), kept)

    def _bounds(self, z0: Array) -> dict[str, Array]:
        N, nz, _, rows = self._shape
        controller = self._controller
        limits, stages = controller.settings.limits, controller.stages
        lower, upper = np.full((nz, N), -np.inf), np.full((nz, N), np.inf)
        bottom, top = (limits.drive_min, -limits.steer, 0.0), (0.0, limits.steer, limits.speed)
        for i, low, high in zip(BOUNDED, bottom, top, strict=True):
            lower[i], upper[i] = low, high
        upper[DRIVE] = stages[controller.problem.stage["drive_max"]][0]
        change = np.repeat(np.array(controller.problem.change_bounds())[:, None], N, axis=1)
        # a side that a row does not have is free, and its slack stays at zero
        masked = np.array(controller.problem.mask_lower) == 0
        g_low = np.zeros((rows, N))
        g_low[masked] = -np.inf
        no_slack, free = np.zeros(2 * rows * N), np.full(2 * rows * N, np.inf)
        return {
            "lbx": np.concatenate([lower.ravel(order="F"), -change.ravel(order="F"), no_slack]),
            "ubx": np.concatenate([upper.ravel(order="F"), change.ravel(order="F"), free]),
            "lbg": np.concatenate([np.zeros(nz * N), g_low.ravel(order="F"), np.zeros(rows * N)]),
            "ubg": np.concatenate([np.zeros(nz * N), np.full(2 * rows * N, np.inf)]),
        }

    def solve(self, z0: Array, z: Array, du: Array, stopwatch: Stopwatch) -> NlpResult:
        """Solve from the guess `z` (NZ, N+1), `du` (NU, N), with the duals of the last solve if there was one."""
        N, nz, nu, rows = self._shape
        controller = self._controller
        theta = np.vstack([np.array(t) for t in self._choice(z[:, 1:], controller.stages, controller.common)])
        parameters = np.concatenate([z0, controller.stages.ravel(order="F"), controller.common, theta.ravel(order="F")])
        slack = np.zeros(2 * rows * N)
        x0 = np.concatenate([z[:, 1:].ravel(order="F"), du.ravel(order="F"), slack])
        duals = {} if self._duals is None else {"lam_x0": self._duals[0], "lam_g0": self._duals[1]}
        bounds = self._bounds(z0)
        start = stopwatch()
        result = self._solver(x0=x0, p=parameters, **bounds, **duals)
        elapsed = stopwatch() - start
        self._duals = np.array(result["lam_x"]).ravel(), np.array(result["lam_g"]).ravel()
        x = np.array(result["x"]).ravel()
        solved_z = np.column_stack([z0, x[: nz * N].reshape(nz, N, order="F")])
        solved_du = x[nz * N : (nz + nu) * N].reshape(nu, N, order="F")
        return NlpResult(solved_z, solved_du, float(result["f"]), elapsed, bool(self._solver.stats()["success"]))
