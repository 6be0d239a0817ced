"""Planner: solvers side by side on recorded steps, the time of a whole plan, the optimality gap of one SQP iteration.

python -m benchmarks.planner [--steps N] [--record FILE | --recorded FILE] [--json]
python -m benchmarks.planner --disturbed N [--steps N]: how many of N recorded and disturbed QPs are solved
python -m benchmarks.planner --plan: only the time of a whole plan and of its parts, of a drive given to it again

Every solver is given the same steps of one closed-loop drive, in turn; the slow ones every twentieth. The peer is HPIPM
of the CasADi wheel, its stage functions compiled one stage at a time. The peer of the gap is the same drive with
every step solved to convergence. Durations are CPU time of the thread. With --record the steps of the plain problem
are kept in a file, with --recorded they come from one. acados is in no package registry and so not on the ladder; the
recorded file holds what another solver needs to be measured on the same steps.
"""

from __future__ import annotations

# this file bears the name of the package it measures: its own folder must not be searched first
import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.progress import track as track_progress

from benchmarks.plans.bench import INFORMATION_WEIGHT, Run, bench_controller, clock, drive
from benchmarks.plans.disturbed import LEVELS, FirstSolverOnly, solved
from benchmarks.plans.ladder import climb, rungs
from benchmarks.plans.plan_parts import recorded_drive, replay, shares
from benchmarks.plans.recorded import load, record, save
from hil_gateway.car.car import load_car
from hil_gateway.config import load_config
from hil_gateway.track.loading import load_track
from hil_gateway.track.track import Track
from planner.plan.exploring import exploring
from planner.problem.settings import Information, Settings, declared_settings
from planner.solver.functions import build_functions
from planner.solver.sqp import Sqp

GAP_ALLOWED = 0.02
CONVERGED_ITERATIONS = 15
SELDOM = 20
"""steps between two that the slow solvers are given"""
PLAN_SECONDS = 8.0
PAUSE_S = 0.04
"""between plans, as in a drive: what a plan needs is no longer in the processor's caches"""
HPIPM_SHARE = 20
"""HPIPM is given one in so many of the disturbed QPs, the first ones: it takes ten times as long"""


def settings(weight: float) -> Settings:
    """Settings with q_I = `weight` and the estimator's measurement model."""
    return replace(declared_settings(load_car()), information=Information(weight=weight, kind="imu_yaw"))


def ladder_rows(track: Track, weight: float, steps: int, files: argparse.Namespace) -> list[dict[str, Any]]:
    """The ladder on one problem; recorded steps are those of the plain one."""
    controller, _ = bench_controller(track, load_car().vehicle, settings(weight))
    plain = weight == 0.0
    recorded = load(files.recorded) if files.recorded and plain else record(controller, steps)
    if files.record and plain:
        save(files.record, recorded)
    functions = build_functions(controller.problem)
    ladder = rungs(controller.problem, functions, controller, clock, SELDOM)
    return [{"problem": "plain" if plain else "infomax", **row} for row in climb(ladder, recorded)]


def disturbed_qps(track: Track, steps: int, count: int) -> list[dict[str, Any]]:
    """QPs solved by the generated solver alone, and by HPIPM on the first of the same ones."""
    rows = []
    for name, weight in (("plain", 0.0), ("infomax", INFORMATION_WEIGHT)):
        controller, _ = bench_controller(track, load_car().vehicle, settings(weight))
        recorded = record(controller, steps)
        functions, each = build_functions(controller.problem), count // (2 * len(LEVELS))
        ours = FirstSolverOnly(controller.problem, functions)
        hpipm = Sqp(controller.problem, replace(functions, library=None), "hpipm")
        for level in LEVELS:
            for solver, sqp, share in (("fixed", ours, 1), ("hpipm", hpipm, HPIPM_SHARE)):
                bar = track_progress(range(each // share), description=f"{name}, {solver}, {level:g}", transient=True)
                rows.append({"problem": name, "solver": solver, **solved(sqp, recorded, level, bar, clock)})
    return rows


def whole_plan(track: Track, seconds: float) -> list[dict[str, Any]]:
    """Duration of a plan from messages to messages and of its parts: driving as shipped, and exploring the paper's car.

    Each once plan after plan and once with pauses. The paper's car explores on its course; the declared race car does
    not yet.
    """
    paper = load_config(None, {"plant.base": "paper", "declared_model": "paper"})
    rows = []
    for name, config in (("driving", load_config()), ("exploring", exploring(paper))):
        drive = recorded_drive(config, seconds)
        for title, pause_s in ((name, 0.0), (f"{name}, after pauses", PAUSE_S)):
            times, _ = replay(config, track, drive, clock, pause_s)
            rows += [{"plan": title, **row} for row in shares(times)]
    return rows


def closed_loop_cost(run: Run, distance: float) -> float:
    """Running cost of a drive per metre of progress, up to `distance` m."""
    progress = np.array([z[6] for z in run.states])
    reached = progress <= distance
    return float(np.sum(np.array(run.cost)[reached]))


def optimality_gap(track: Track, weight: float, steps: int) -> dict[str, float]:
    """Closed-loop cost of the real-time iteration against solving every step to convergence."""
    runs = []
    for converge in (0, CONVERGED_ITERATIONS):
        controller, _ = bench_controller(track, load_car().vehicle, settings(weight))
        runs.append(drive(controller, 1, steps=steps, converge=converge))
    fast, full = runs
    distance = min(fast.states[-1][6], full.states[-1][6])
    a, b = (closed_loop_cost(run, distance) for run in runs)
    return {
        "cost": a, "converged_cost": b, "gap": (a - b) / abs(b), "distance_m": float(distance),
        "time_s": sum(z[6] <= distance for z in fast.states) * 0.05,
        "converged_time_s": sum(z[6] <= distance for z in full.states) * 0.05,
    }  # fmt: skip


def main() -> int:
    """Print the tables; exit 1 when the gap is larger than allowed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=120, help="steps a drive; 2000 are a lap")
    parser.add_argument("--record", type=Path, help="keep the recorded steps in this file (npz)")
    parser.add_argument("--recorded", type=Path, help="solve the steps in this file instead of driving")
    parser.add_argument("--disturbed", type=int, default=0, help="only count what is solved of so many QPs")
    parser.add_argument("--plan", action="store_true", help="only the time of a whole plan and its parts")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    track = load_track()
    if arguments.disturbed or arguments.plan:
        table = (
            whole_plan(track, PLAN_SECONDS) if arguments.plan
            else disturbed_qps(track, arguments.steps, arguments.disturbed)
        )  # fmt: skip
        print(json.dumps(table) if arguments.json else "\n".join(aligned(table)))
        return 0
    rows = [
        row for weight in (0.0, INFORMATION_WEIGHT) for row in ladder_rows(track, weight, arguments.steps, arguments)
    ]
    result: dict[str, Any] = {"timing_ms": rows, "whole_plan": whole_plan(track, PLAN_SECONDS)}
    for name, weight in (("plain", 0.0), ("infomax", INFORMATION_WEIGHT)):
        result[f"optimality_gap_{name}"] = optimality_gap(track, weight, arguments.steps)
    print(json.dumps(result) if arguments.json else report(result))
    gaps = [result[f"optimality_gap_{name}"]["gap"] for name in ("plain", "infomax")]
    return 0 if max(gaps) <= GAP_ALLOWED else 1


def aligned(rows: list[dict[str, Any]]) -> list[str]:
    """Lines of a table."""
    widths = {c: max(len(c), *(len(str(row[c])) for row in rows)) for c in rows[0]}
    header = "  ".join(f"{c:>{width}}" for c, width in widths.items())
    return [header, *("  ".join(f"{row[c]!s:>{width}}" for c, width in widths.items()) for row in rows)]


def report(result: dict[str, Any]) -> str:
    """Tables for people."""
    lines = [*aligned(result["timing_ms"]), *aligned(result["whole_plan"])]
    for name in ("plain", "infomax"):
        gap = result[f"optimality_gap_{name}"]
        lines.append(
            f"{name}: closed-loop cost {gap['cost']:.2f}, converged {gap['converged_cost']:.2f}, "
            f"gap {100 * gap['gap']:.2f} % (allowed {100 * GAP_ALLOWED:.0f} %)"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
