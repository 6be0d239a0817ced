"""Which QP solvers run on this machine: the self-tests that decide, and a warning for each that fails."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass

from hil_gateway.process.compiled import find_compiler
from planner.solver import fixed
from planner.solver.hpipm import HpipmSolver, self_test
from planner.solver.qp import QpSolver, QpWarning, StageQp
from planner.solver.qp_sparse import ConicSolver, PiqpSolver
from planner.solver.self_test import small_qp


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


@dataclass(frozen=True)
class SolversHere:
    """`first` is tried for every QP, `second` where that fails; `lacks` says why `first` is not the fastest one."""

    first: str
    second: str
    compiler: str
    lacks: str


def solvers_here() -> SolversHere:
    """Run the self-tests and say what they find."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        second, lacks = make_qp_solver(small_qp()).name, _why_not_generated()
    return SolversHere(second if lacks else "fixed", second, find_compiler() or "", lacks)


def _why_not_generated() -> str:
    if find_compiler() is None:
        return "no C compiler"
    try:
        fixed.self_test()
    except (OSError, RuntimeError) as error:
        return str(error)
    return ""
