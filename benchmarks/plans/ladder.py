"""Solvers side by side on the same recorded steps, in turn, so that what slows the machine slows them all."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.plans.reference_nlp import ReferenceNlp
from hil_gateway.process.compiled import compile_function
from planner.plan.controller import Controller
from planner.problem.mpcc import Problem
from planner.solver.functions import Functions
from planner.solver.sqp import Sqp, Step, Stopwatch

SHIPPED = "hpipm"
"""the rung the others are measured by: HPIPM of the CasADi wheel, stage functions compiled one stage at a time"""


@dataclass(frozen=True)
class Rung:
    """One solver: `solve` gives duration, part of it in the linearisation (ns; 0 where it is not apart), and success.

    Only every `every`-th step is given to it.
    """

    solve: Callable[[Step], tuple[int, int, bool]]
    every: int = 1


def sqp_rung(sqp: Sqp, stopwatch: Stopwatch, every: int = 1) -> Rung:
    """An SQP method; with `every` = 1 multipliers stay a warm start from step to step."""

    def solve(step: Step) -> tuple[int, int, bool]:
        if every == 1:
            sqp.shift_multipliers()
        else:
            sqp.set_guess(step.z, step.du)
        start = stopwatch()
        solution = sqp.solve_step(step, stopwatch)
        return stopwatch() - start, solution.linearise_ns, solution.usable

    return Rung(solve, every)


def nlp_rung(controller: Controller, nlp: ReferenceNlp, stopwatch: Stopwatch, every: int) -> Rung:
    """IPOPT from the same guess, with its own multipliers of the step before."""

    def solve(step: Step) -> tuple[int, int, bool]:
        guess = step.z.copy()
        guess[:, 0] = step.z0
        controller.stages[:], controller.common[:] = step.stages, step.common
        result = nlp.solve(step.z0, guess, step.du.copy(), stopwatch)
        return result.solve_ns, 0, result.converged

    return Rung(solve, every)


def rungs(
    problem: Problem, functions: Functions, controller: Controller, stopwatch: Stopwatch, seldom: int
) -> dict[str, Rung]:
    """Every solver there is here; slow ones are given every `seldom`-th step."""
    shipped = replace(functions, library=None, horizon=compile_function(problem.horizon_function()))
    vm = replace(functions, library=None, horizon=compile_function(problem.horizon_function(), compiled=False))
    vector = replace(functions, library=None)
    found = {} if functions.library is None else {"fixed": sqp_rung(Sqp(problem, functions, "fixed"), stopwatch)}
    found |= {
        SHIPPED: sqp_rung(Sqp(problem, shipped, "hpipm"), stopwatch),
        "hpipm, vector stages": sqp_rung(Sqp(problem, vector, "hpipm"), stopwatch),
        "hpipm, no compiler": sqp_rung(Sqp(problem, vm, "hpipm"), stopwatch),
    }
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found["piqp"] = sqp_rung(Sqp(problem, vector, "piqp"), stopwatch, seldom)
    found["ipopt, compiled"] = nlp_rung(controller, ReferenceNlp(controller, compiled=True), stopwatch, seldom)
    found["ipopt"] = nlp_rung(controller, ReferenceNlp(controller), stopwatch, seldom)
    return found


def climb(ladder: Mapping[str, Rung], steps: Sequence[Step]) -> list[dict[str, Any]]:
    """One row a solver: median and 99 % point in ms, failures, and both over those of `SHIPPED` on the same steps."""
    taken: dict[str, list[tuple[int, int, int, bool]]] = {name: [] for name in ladder}
    for k, step in enumerate(steps):
        for name, rung in ladder.items():
            if k % rung.every == 0:
                taken[name].append((k, *rung.solve(step)))
    peer = {k: total for k, total, _, _ in taken[SHIPPED]}
    return [_row(name, rows, [peer[row[0]] for row in rows]) for name, rows in taken.items()]


def _row(name: str, rows: list[tuple[int, int, int, bool]], peer: list[int]) -> dict[str, Any]:
    total = np.array([row[1] for row in rows]) / 1e6
    linear = float(np.median([row[2] for row in rows])) / 1e6
    (p50, p99), (peer50, peer99) = (np.percentile(a, [50, 99]) for a in (total, np.array(peer) / 1e6))
    return {
        "solver": name, "steps": len(rows), "failures": sum(not row[3] for row in rows), "p50": _short(p50),
        "p99": _short(p99), "linearise": _short(linear), "p50_over_hpipm": _short(p50 / peer50),
        "p99_over_hpipm": _short(p99 / peer99),
    }  # fmt: skip


def _short(value: float) -> float:
    """Three significant figures."""
    return round(float(value), 2 - math.floor(math.log10(value))) if value > 0 else 0.0
