"""`hil campaign diagnose`: every switch of the simulated car over seeds, and what the diagnosis makes of it.

A trial is one effect (or none) and one seed: eight progressively faster laps of the simulated car, whose equations are
not the estimator's, with the effect between 0.7 and 1.3 times the size that campaigns use. A trial already in the
folder is not repeated.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from estimator.model.parameters import tyre_prior
from hil_gateway.car.car import load_car
from hil_gateway.plant.physics.effects import SWITCHES, implied
from hil_gateway.process.children import pool
from hil_gateway.process.figures import figure

NONE = "none"
SIZE_SPREAD = 0.3
"""Sizes lie within this share of the example size."""


@dataclass(frozen=True)
class Case:
    """One drive of the campaign."""

    effect: str
    seed: int

    @property
    def size(self) -> float:
        """Size of the effect; the same for the same seed."""
        if self.effect == NONE:
            return 0.0
        draw = np.random.default_rng([self.seed, sorted(SWITCHES).index(self.effect)])
        switch = SWITCHES[self.effect]
        drawn = switch.example * draw.uniform(1.0 - SIZE_SPREAD, 1.0 + SIZE_SPREAD)
        return float(np.clip(drawn, switch.low, switch.high))

    @property
    def truth(self) -> tuple[str, ...]:
        """Effects the drive really holds, the one asked for first."""
        return () if self.effect == NONE else (self.effect, *implied(self.effect))


def run_case(case: Case, laps: int) -> dict[str, Any]:
    """Drive and diagnose; plain data."""
    from benchmarks.driving.simulated_log import simulate
    from estimator.offline.diagnosis import diagnose
    from estimator.offline.record.record import make_record
    from estimator.offline.report.diagnosis_result import as_json

    log = simulate({case.effect: case.size} if case.truth else {}, laps=laps, seed=case.seed)
    found = as_json(
        diagnose(make_record(log, load_car().vehicle), "per_axle", tyre_prior(load_car(), "per_axle")), "", ""
    )
    return {
        "effect": case.effect, "seed": case.seed, "size": case.size, "laps": laps, "truth": case.truth,
        "verdict": found["verdict"], "named": [e["name"] for e in found["effects"]],
        "parameters": {e["name"]: e["parameters"] for e in found["effects"]}, "channels": found["channels"],
        "unexplained": [(u["channel"], u["signal"]) for u in found["unexplained"]],
    }  # fmt: skip


def run_cases(cases: Sequence[Case], laps: int, out: Path, processes: int) -> Iterator[dict[str, Any]]:
    """Results as they come, those already in `out` first; every new one is written there."""
    out.mkdir(parents=True, exist_ok=True)
    places = {case: out / f"{case.effect}-{case.seed:03d}-{laps}.json" for case in cases}
    for place in places.values():
        if place.exists():
            yield json.loads(place.read_text())
    missing = [case for case, place in places.items() if not place.exists()]
    with pool(processes) as executor:
        futures = {executor.submit(run_case, case, laps): case for case in missing}
        for future in as_completed(futures):
            places[futures[future]].write_text(json.dumps(future.result()))
            yield json.loads(places[futures[future]].read_text())


def verdict_of(result: dict[str, Any]) -> str:
    """Column of the confusion matrix: the effect named first, `none`, or `unexplained`."""
    return str(result["named"][0]) if result["named"] else str(result["verdict"])


def summarise(results: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Confusion matrix and the shares asked for."""
    on, off = ([r for r in results if (r["effect"] == NONE) is wanted] for wanted in (False, True))
    confusion: dict[str, Counter[str]] = {}
    for result in results:
        confusion.setdefault(result["effect"], Counter())[verdict_of(result)] += 1
    return {
        "cases": len(results),
        "named_first": _share(r["named"][:1] == [r["effect"]] for r in on),
        "nothing_but_the_truth": _share(bool(r["named"]) and set(r["named"]) <= set(r["truth"]) for r in on),
        "false_alarms": _share(r["verdict"] != NONE for r in off),
        "confusion": {effect: dict(row) for effect, row in sorted(confusion.items())},
    }


def _share(hits: Iterator[bool]) -> float | None:
    counted = list(hits)
    return sum(counted) / len(counted) if counted else None


def write_report(results: Sequence[dict[str, Any]], summary: dict[str, Any], path: Path) -> Path:
    """The campaign as one HTML page: shares, confusion matrix, every case."""
    from estimator.offline.report.page import ReportPage

    report = ReportPage("Diagnosis campaign", f"{summary['cases']} drives of the simulated car")
    report.tiles([
        ("named first", percent(summary["named_first"]), "effect switched on"),
        ("nothing but the truth", percent(summary["nothing_but_the_truth"]), "effect switched on"),
        ("false alarms", percent(summary["false_alarms"]), "nothing switched on"),
    ])  # fmt: skip
    columns = sorted({column for row in summary["confusion"].values() for column in row})
    rows = [[effect, *(str(row.get(c, "")) for c in columns)] for effect, row in summary["confusion"].items()]
    report.section("Confusion matrix", "Rows: what was switched on. Columns: what was named first, or the verdict.")
    report.table(["switched on", *columns], rows)
    report.section("Cases")
    cells = [[r["effect"], str(r["seed"]), f"{r['size']:.4g}", r["verdict"], ", ".join(r["named"])] for r in results]
    report.table(["switched on", "seed", "size", "verdict", "named"], cells)
    return report.write(path)


def percent(share: float | None) -> str:
    """A share for people."""
    return "not driven" if share is None else figure(100 * share, "%", 3)
