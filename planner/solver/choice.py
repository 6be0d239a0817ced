"""Which QP solvers run on this machine: the self-tests that decide, and a warning for each that fails."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from hil_gateway.process.compiled import find_compiler
from planner.solver import fixed
from planner.solver.hpipm import HpipmSolver, self_test
from planner.solver.qp import QpSolver, QpWarning, StageQp
from planner.solver.qp_sparse import PiqpSolver
from planner.solver.self_test import small_qp


class Listed(NamedTuple):
    """A solver of the list."""

    make: Callable[[StageQp], QpSolver]
    slower: int
    """its median time over HPIPM's (docs/planner.md)"""


def _tested_hpipm(qp: StageQp) -> QpSolver:
    self_test()
    return HpipmSolver(qp)


SOLVERS = {"hpipm": Listed(_tested_hpipm, 1), "piqp": Listed(PiqpSolver, 18)}
"""in the order in which they are tried"""


def make_qp_solver(qp: StageQp, backend: str = "auto") -> QpSolver:
    """First of `SOLVERS` that works on this machine, or the one named.

    Raises:
        ValueError: unknown backend.
        RuntimeError: no backend works.
    """
    order = list(SOLVERS) if backend == "auto" else [backend]
    if unknown := set(order) - set(SOLVERS):
        raise ValueError(f"unknown QP backend {unknown.pop()}")
    while order:
        name = order.pop(0)
        try:
            return SOLVERS[name].make(qp)
        except (OSError, AttributeError, ImportError, RuntimeError) as error:
            warnings.warn(f"QP solver {name} is not usable ({error}); {_cost(order)}", QpWarning, stacklevel=2)
    raise RuntimeError("no QP solver is usable")


def _cost(left: list[str]) -> str:
    """What it means that only these are left."""
    return f"falling back to {left[0]}, about {SOLVERS[left[0]].slower} times slower" if left else "no further fallback"


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
