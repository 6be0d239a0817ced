"""QP solvers that take one sparse matrix: slower fallbacks for machines where HPIPM cannot be used.

Slacks become variables: x = (du_0, dz_1, slack_lower_1, slack_upper_1, du_1, ...). The sparsity pattern is fixed.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from hil_gateway.process.arrays import Array
from planner.solver.qp import QpStatus, StageQp


class SparseForm:
    """The QP as min 1/2 x'Px + c'x, lower_a <= Ax <= upper_a, lower_x <= x <= upper_x."""

    def __init__(self, qp: StageQp) -> None:
        size = qp.size
        self.qp = qp
        self.width = size.nu + size.nx + 2 * size.rows
        self.n = self.width * size.N
        # the sides that exist: (slack above the lower bound, below the upper bound)
        self._lower_rows = np.flatnonzero(qp.mask_lower > 0)
        self._upper_rows = np.flatnonzero(qp.mask_upper > 0)
        self.height = size.nx + len(self._lower_rows) + len(self._upper_rows)
        self._u = slice(0, size.nu)
        self._z = slice(size.nu, size.nu + size.nx)
        self._low = slice(size.nu + size.nx, size.nu + size.nx + size.rows)
        self._up = slice(size.nu + size.nx + size.rows, self.width)

    def matrices(self) -> tuple[Any, Array, Any, Array, Array, Array, Array]:
        """P (upper and lower), c, A, lower_a, upper_a, lower_x, upper_x; P and A in compressed-column form."""
        from scipy import sparse

        qp, size = self.qp, self.qp.size
        rows = size.rows
        cost: list[Array] = []
        c, lower_x, upper_x = (np.zeros((size.N, self.width)) for _ in range(3))
        A = sparse.lil_matrix((self.height * size.N, self.n))
        low_a, up_a = np.zeros((size.N, self.height)), np.zeros((size.N, self.height))
        for k in range(size.N):
            cost += [qp.stage(qp.R, k), qp.stage(qp.Q, k), np.diag(np.tile(qp.slack_l2[:, k], 2))]
            c[k] = np.concatenate([qp.r[:, k], qp.q[:, k], np.tile(qp.slack_l1[:, k], 2)])
            lower_x[k], upper_x[k] = self._bounds(k)
            low_a[k], up_a[k] = self._row_bounds(k)
            r, v = k * self.height, k * self.width
            A[r : r + size.nx, v : v + size.nu] = qp.stage(qp.B, k)
            A[r : r + size.nx, v + size.nu : v + size.nu + size.nx] = -np.eye(size.nx)
            if k:
                A[r : r + size.nx, v - self.width + size.nu : v - self.width + size.nu + size.nx] = qp.stage(qp.A, k)
            r += size.nx
            for sides, slack, sign in ((self._lower_rows, self._low, 1.0), (self._upper_rows, self._up, -1.0)):
                block = slice(r, r + len(sides))
                A[block, v + self._z.start : v + self._z.stop] = qp.stage(qp.C, k)[sides]
                A[block, v + slack.start : v + slack.stop] = sign * np.eye(rows)[sides]
                r += len(sides)
        P = sparse.block_diag(cost, format="csc")
        return P, c.ravel(), A.tocsc(), low_a.ravel(), up_a.ravel(), lower_x.ravel(), upper_x.ravel()

    def _bounds(self, k: int) -> tuple[Array, Array]:
        qp, size = self.qp, self.qp.size
        lower, upper = np.full(self.width, -np.inf), np.full(self.width, np.inf)
        bounded = np.array(size.bounded, dtype=int) + size.nu
        lower[self._u], upper[self._u] = qp.lower_u[:, k], qp.upper_u[:, k]
        lower[bounded], upper[bounded] = qp.lower_z[:, k], qp.upper_z[:, k]
        lower[size.nu + size.nx :] = 0.0
        return lower, upper

    def _row_bounds(self, k: int) -> tuple[Array, Array]:
        qp = self.qp
        low, up = qp.lower_row[self._lower_rows, k], qp.upper_row[self._upper_rows, k]
        lower = np.concatenate([-qp.b[:, k], low, np.full(len(up), -np.inf)])
        return lower, np.concatenate([-qp.b[:, k], np.full(len(low), np.inf), up])

    def store_multipliers(self, values: Array) -> None:
        """Multipliers >= 0 of the upper sides, given those of all soft sides in the order of the rows of A."""
        blocks = values.reshape(self.qp.size.N, self.height - self.qp.size.nx)
        self.qp.multiplier[:] = 0.0
        self.qp.multiplier[self._upper_rows] = blocks[:, len(self._lower_rows) :].T

    def store(self, x: Array) -> QpStatus:
        """Write the solution back into the `StageQp`."""
        if not np.isfinite(x).all():
            return QpStatus.NOT_FINITE
        blocks = x.reshape(self.qp.size.N, self.width)
        self.qp.du[:] = blocks[:, self._u].T
        self.qp.dz[:] = blocks[:, self._z].T
        return QpStatus.SOLVED


class PiqpSolver:
    """PIQP, a proximal interior-point method (Schwan et al., 2023)."""

    name = "piqp"

    def __init__(self, qp: StageQp) -> None:
        import piqp  # noqa: F401  - absent package is an ImportError here, not in the loop

        self.form = SparseForm(qp)
        self.iterations = 0

    def solve(self) -> QpStatus:
        import piqp

        P, c, A, low, up, lower_x, upper_x = self.form.matrices()
        equal = low == up
        solver = piqp.SparseSolver()
        solver.settings.eps_abs = 1e-6
        solver.setup(P, c, A[equal], low[equal], A[~equal], low[~equal], up[~equal], lower_x, upper_x)
        status = solver.solve()
        self.iterations = int(solver.result.info.iter)
        if status != piqp.PIQP_SOLVED:
            limit = status == piqp.PIQP_MAX_ITER_REACHED
            return QpStatus.ITERATION_LIMIT if limit else QpStatus.INFEASIBLE
        self.form.store_multipliers(np.asarray(solver.result.z_u))
        return self.form.store(np.asarray(solver.result.x))
