"""Planner: where the time of a step goes, the optimality gap of one SQP iteration, fallbacks.

python benchmarks/planner.py [--steps N] [--json]

The peer of the timing table is the same problem solved with each fallback in the same run; the peer of the gap is the
same drive with every step solved to convergence. Durations are CPU time of the thread.
"""

from __future__ import annotations

import sys
from pathlib import Path

# this file bears the name of the package it measures: its own folder must not be searched first
sys.path[:] = [p for p in sys.path if Path(p or ".").resolve() != Path(__file__).resolve().parent]

# ruff: noqa: E402
import argparse
import json
import warnings
from typing import Any

import numpy as np

from hil_gateway.car.vehicle import Vehicle
from hil_gateway.track.loading import load_track
from hil_gateway.track.track import Track
from planner.problem.settings import Information, Settings
from planner.studies.bench import INFORMATION_WEIGHT, Run, bench_controller, drive, percentiles

GAP_ALLOWED = 0.02
CONVERGED_ITERATIONS = 15


def settings(weight: float) -> Settings:
    """Settings with q_I = `weight` and the estimator's measurement model."""
    return Settings(information=Information(weight=weight, kind="imu_yaw"))


def timing(track: Track, weight: float, backend: str, compiled: bool, steps: int) -> dict[str, Any]:
    """Median and 99 % point of the parts of a step, ms."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        controller, _ = bench_controller(track, Vehicle(), settings(weight), backend=backend, compiled=compiled)
        run = drive(controller, 1, steps=steps)
    whole, linearise, qp = (percentiles(ns) for ns in (run.solve_ns, run.linearise_ns, run.qp_ns))
    rest = whole["p50"] - linearise["p50"] - qp["p50"]
    return {
        "problem": "infomax" if weight else "plain", "backend": controller.sqp.backend,
        "iterations": controller.settings.iterations, "linearise": linearise["p50"], "qp": qp["p50"],
        "rest": round(rest, 4), "total": whole["p50"], "p99": whole["p99"], "failures": run.qp_failures,
    }  # fmt: skip


def closed_loop_cost(run: Run, distance: float) -> float:
    """Running cost of a drive per metre of progress, up to `distance` m."""
    progress = np.array([z[6] for z in run.states])
    reached = progress <= distance
    return float(np.sum(np.array(run.cost)[reached]))


def optimality_gap(track: Track, weight: float, steps: int) -> dict[str, float]:
    """Closed-loop cost of the real-time iteration against solving every step to convergence."""
    runs = []
    for converge in (0, CONVERGED_ITERATIONS):
        controller, _ = bench_controller(track, Vehicle(), settings(weight))
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
    parser.add_argument("--steps", type=int, default=400, help="steps a drive; 2000 are a lap")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    track = load_track()
    rows = [
        timing(track, 0.0, "hpipm", True, arguments.steps),
        timing(track, 0.0, "hpipm", False, arguments.steps),
        timing(track, INFORMATION_WEIGHT, "hpipm", True, arguments.steps),
        timing(track, 0.0, "piqp", True, max(20, arguments.steps // 20)),
        timing(track, 0.0, "conic", True, max(20, arguments.steps // 20)),
    ]
    result: dict[str, Any] = {"timing_ms": rows}
    for name, weight in (("plain", 0.0), ("infomax", INFORMATION_WEIGHT)):
        result[f"optimality_gap_{name}"] = optimality_gap(track, weight, arguments.steps)
    print(json.dumps(result) if arguments.json else report(result))
    gaps = [result[f"optimality_gap_{name}"]["gap"] for name in ("plain", "infomax")]
    return 0 if max(gaps) <= GAP_ALLOWED else 1


def report(result: dict[str, Any]) -> str:
    """Tables for people."""
    columns = ("problem", "backend", "iterations", "linearise", "qp", "rest", "total", "p99", "failures")
    lines = ["  ".join(f"{c:>10}" for c in columns)]
    lines += ["  ".join(f"{row[c]!s:>10}" for c in columns) for row in result["timing_ms"]]
    for name in ("plain", "infomax"):
        gap = result[f"optimality_gap_{name}"]
        lines.append(
            f"{name}: closed-loop cost {gap['cost']:.2f}, converged {gap['converged_cost']:.2f}, "
            f"gap {100 * gap['gap']:.2f} % (allowed {100 * GAP_ALLOWED:.0f} %)"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
