"""Which QP solver runs here: the fastest that passes its self-test, and a warning for every one that does not."""

from __future__ import annotations

import warnings
from collections.abc import Callable

from planner.solver.hpipm import HpipmSolver, self_test
from planner.solver.qp import QpSolver, QpWarning, StageQp
from planner.solver.qp_sparse import ConicSolver, PiqpSolver


def make_qp_solver(qp: StageQp, backend: str = "auto") -> QpSolver:
    """Fastest solver that passes its self-test on this machine: hpipm, piqp, CasADi conic, in this order.

    Raises:
        ValueError: unknown backend.
        RuntimeError: no backend works.
    """
    solvers: dict[str, Callable[[StageQp], QpSolver]]
    solvers = {"hpipm": HpipmSolver, "piqp": PiqpSolver, "conic": ConicSolver}
    order = ("hpipm", "piqp", "conic") if backend == "auto" else (backend,)
    if unknown := set(order) - set(solvers):
        raise ValueError(f"unknown QP backend {unknown.pop()}")
    for name in order:
        try:
            if name == "hpipm":
                self_test()
            return solvers[name](qp)
        except (OSError, AttributeError, ImportError, RuntimeError) as error:
            warnings.warn(f"QP solver {name} is not usable ({error}); {_COST[name]}", QpWarning, stacklevel=2)
    raise RuntimeError("no QP solver is usable")


_COST = {
    "hpipm": "falling back to piqp, about 4 times slower",
    "piqp": "falling back to CasADi conic, about 5 times slower than hpipm",
    "conic": "no further fallback",
}
