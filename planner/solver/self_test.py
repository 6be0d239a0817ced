"""A small QP with active hard and soft constraints: a solver must find its known optimum before it is trusted."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from planner.solver.qp import QpSize, QpSolver, QpStatus, StageQp, objective, violation

OPTIMUM = 8.5988
"""found by an independent solver on `small_qp`"""


def small_qp(N: int = 6) -> StageQp:
    """Double integrator with a tight force bound and a soft speed limit that cannot be met."""
    qp = StageQp(QpSize(N, 2, 1, (0,), 1))
    for k in range(N):
        qp.stage(qp.A, k)[:] = [[1.0, 0.1], [0.0, 1.0]]
        qp.stage(qp.B, k)[:] = [[0.005], [0.1]]
        qp.stage(qp.Q, k)[:] = np.diag([2.0, 0.2])
        qp.stage(qp.R, k)[:] = 0.1
        qp.stage(qp.C, k)[:] = [[0.0, 1.0]]
    qp.b[:, 0] = (1.0, -2.0)
    qp.lower_z[:], qp.upper_z[:] = -5.0, 5.0
    qp.lower_u[:], qp.upper_u[:] = -4.0, 4.0
    qp.lower_row[:], qp.upper_row[:] = -1.0, 1.0
    qp.slack_l1[:], qp.slack_l2[:] = 3.0, 1.0
    return qp


def check(make: Callable[[StageQp], QpSolver]) -> None:
    """Compare a solver's answer with the known optimum.

    Raises:
        RuntimeError: it answers wrongly.
    """
    qp = small_qp()
    status = make(qp).solve()
    if status is not QpStatus.SOLVED or violation(qp) > 1e-5 or not abs(objective(qp) - OPTIMUM) < 1e-3:
        raise RuntimeError(f"self-test failed: {status.value}, cost {objective(qp):.6g} for {OPTIMUM}")
