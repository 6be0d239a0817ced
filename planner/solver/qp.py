"""Quadratic programs with optimal-control structure, and the choice of a solver for them.

One QP of the SQP method, in the steps (delta z, delta u) around the current guess. z_0 is given, so delta z_0 = 0:

    min  sum_{k=1..N} 1/2 dz_k' Q_k dz_k + q_k' dz_k + sum_{k=0..N-1} 1/2 du_k' R_k du_k + r_k' du_k + soft penalty
    s.t. dz_{k+1} = A_k dz_k + B_k du_k + b_k
         lower bounds <= du_k, bounded entries of dz_k <= upper bounds           (hard)
         lower_row <= C_k dz_k <= upper_row, k = 1..N                            (soft: slack with L1 + L2 penalty)

Arrays are column-major with one block of columns a stage, so that compiled code fills them and the solver reads
them without a copy. Block k of A, B, b, R, r, du is interval k = 0..N-1; block k of Q, q, C, rows and dz is stage k+1.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Protocol

import numpy as np

from hil_gateway.process.arrays import Array


class QpWarning(UserWarning):
    """A slower QP solver than the preferred one is used."""


class QpStatus(Enum):
    """How a QP solve ended; only SOLVED may be used."""

    SOLVED = "solved"
    ITERATION_LIMIT = "iteration limit"
    SMALL_STEP = "step too small"
    NOT_FINITE = "not finite"
    INFEASIBLE = "infeasible"


@dataclass(frozen=True)
class QpSize:
    """Dimensions: `bounded` are the indices of the states with hard bounds, `rows` the number of soft rows a stage."""

    N: int
    nx: int
    nu: int
    bounded: tuple[int, ...]
    rows: int


class StageQp:
    """Data and solution of one QP; arrays are allocated once.

    `multiplier` (rows, N) are those of the upper sides of the soft rows, >= 0.
    `mask_lower`, `mask_upper` (rows,) switch sides of soft rows off; `slack_l1`, `slack_l2` (rows, N) penalise slack.
    """

    def __init__(self, size: QpSize) -> None:
        N, nx, nu, nb, rows = size.N, size.nx, size.nu, len(size.bounded), size.rows

        def zeros(n: int, columns: int) -> Array:
            return np.zeros((n, columns), order="F")

        self.size = size
        self.A, self.B, self.b = zeros(nx, nx * N), zeros(nx, nu * N), zeros(nx, N)
        self.Q, self.q = zeros(nx, nx * N), zeros(nx, N)
        self.R, self.r = zeros(nu, nu * N), zeros(nu, N)
        self.C, self.lower_row, self.upper_row = zeros(rows, nx * N), zeros(rows, N), zeros(rows, N)
        self.lower_z, self.upper_z = zeros(nb, N), zeros(nb, N)
        self.lower_u, self.upper_u = zeros(nu, N), zeros(nu, N)
        self.slack_l1, self.slack_l2 = zeros(rows, N), zeros(rows, N)
        self.mask_lower, self.mask_upper = np.ones(rows), np.ones(rows)
        self.dz, self.du = zeros(nx, N), zeros(nu, N)
        self.multiplier = zeros(rows, N)

    def stage(self, matrix: Array, k: int) -> Array:
        """Block k of a column-major array of N blocks (a view)."""
        width = matrix.shape[1] // self.size.N
        return matrix[:, k * width : (k + 1) * width]


class QpSolver(Protocol):
    """Solves the `StageQp` it was made for, in place."""

    name: str
    iterations: int

    def solve(self) -> QpStatus:
        """Read the data, write `dz`, `du` and `multiplier`; they are meaningful only if the result is SOLVED."""
        ...


def objective(qp: StageQp) -> float:
    """Cost of the step in `dz`, `du`, with the cheapest slacks that make it feasible."""
    total = 0.0
    for k in range(qp.size.N):
        z, u = qp.dz[:, k], qp.du[:, k]
        total += float(
            0.5 * z @ qp.stage(qp.Q, k) @ z + qp.q[:, k] @ z + 0.5 * u @ qp.stage(qp.R, k) @ u + qp.r[:, k] @ u
        )
        value = qp.stage(qp.C, k) @ z
        for excess, mask in ((qp.lower_row[:, k] - value, qp.mask_lower), (value - qp.upper_row[:, k], qp.mask_upper)):
            slack = np.maximum(excess, 0.0) * mask
            total += float(qp.slack_l1[:, k] @ slack + 0.5 * qp.slack_l2[:, k] @ slack**2)
    return float(total)


def violation(qp: StageQp) -> float:
    """Largest violation of dynamics or hard bounds by the step in `dz`, `du`."""
    worst = 0.0
    previous = np.zeros(qp.size.nx)
    bounded = list(qp.size.bounded)
    for k in range(qp.size.N):
        z, u = qp.dz[:, k], qp.du[:, k]
        defect = qp.stage(qp.A, k) @ previous + qp.stage(qp.B, k) @ u + qp.b[:, k] - z
        over = (
            np.abs(defect),
            qp.lower_z[:, k] - z[bounded],
            z[bounded] - qp.upper_z[:, k],
            qp.lower_u[:, k] - u,
            u - qp.upper_u[:, k],
        )
        worst = max(worst, *(float(np.max(o, initial=0.0)) for o in over))
        previous = z
    return worst
