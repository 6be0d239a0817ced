"""Campaign over practice drives: every effect by seeds, confusion matrix, sizes, error removed.

    python benchmarks/diagnose.py [--seeds N] [--only NAME ...] [--pairs N] [--workers N] [--json FILE]

The drives come from `practice.py`, whose equations are independent of the estimator's model. A single effect
counts as right when it is named first, as alone when nothing else is named; outside the catalogue the verdict
must be `unexplained` with the right channel and signal.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
import time
from collections import Counter, defaultdict
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from practice import OUTSIDE, SIZES, Drive, draw_size, simulate

from estimator.diagnose.diagnosis import diagnose
from estimator.diagnose.record import make_record
from estimator.diagnose.result import as_json
from estimator.identify.drive_log import DriveLog
from hil_gateway.vehicle import Vehicle

BATCH = 48
"""Drives simulated side by side."""
NEEDS_ANOTHER = {"load_sensitivity": {"aero_downforce": 1.5}}
PAIRS = (
    ("aero_drag", "rolling_resistance"), ("aero_drag", "steer_offset"), ("road_grade", "aero_drag"),
    ("aero_downforce", "aero_drag"), ("combined_slip", "load_transfer"), ("imu_bias", "steer_offset"),
    ("tyre_relaxation", "steer_scale"), ("road_bank", "road_grade"), ("yaw_damping", "grip_drift"),
    ("engine_braking", "aero_drag"), ("speed_scale", "drive_saturation"), ("wind", "aero_drag"),
)  # fmt: skip
# parameter of a diagnosis that the size of a simulated effect corresponds to
MAIN = {
    "aero_drag": "k", "rolling_resistance": "force", "load_transfer": "height", "combined_slip": "k",
    "drive_saturation": "force", "front_brake": "share", "engine_braking": "force", "steer_offset": "offset",
    "steer_delay": "delay", "drive_delay": "delay", "tyre_relaxation": "length", "grip_drift": "rate",
    "imu_misalignment": "angle", "imu_lever_arm": "x", "yaw_damping": "k", "turn_asymmetry": "k",
}  # fmt: skip
FACTORS = {"steer_scale": "scale", "speed_scale": "scale"}


@dataclass(frozen=True)
class Case:
    """One diagnosed drive."""

    effects: dict[str, float]
    seed: int
    result: dict[str, Any]
    seconds: float

    @property
    def label(self) -> str:
        """What was simulated."""
        return " + ".join(sorted(self.effects)) or "none"

    @property
    def named(self) -> list[str]:
        """What was found."""
        return [e["name"] for e in self.result["effects"]]

    @property
    def right(self) -> bool:
        """Whether the verdict is the right one."""
        wanted = set(self.effects)
        if not wanted:
            return bool(self.result["verdict"] == "none")
        if outside := wanted & set(OUTSIDE):
            channels, signals = OUTSIDE[next(iter(outside))]
            return any(u["channel"] in channels and u["signal"] in signals for u in self.result["unexplained"])
        return wanted <= set(self.named) if len(wanted) > 1 else self.named[:1] == list(wanted)

    @property
    def alone(self) -> bool:
        """Right, with nothing else named."""
        if set(self.effects) & set(OUTSIDE):
            return self.right and not self.named
        return self.right and set(self.named) == set(self.effects) and not self.result["unexplained"]

    def size_error(self) -> tuple[float, float] | None:
        """Relative error of the main parameter, and in standard deviations, for a single effect that has one."""
        if len(self.effects) != 1 or not self.right:
            return None
        (name, size), found = next(iter(self.effects.items())), self.result["effects"]
        key = MAIN.get(name) or FACTORS.get(name)
        if key is None or not found:
            return None
        parameter = found[0]["parameters"][key]
        error = parameter["value"] - (1.0 + size if name in FACTORS else size)
        return abs(error / size), abs(error) / parameter["std"]

    def removed(self) -> float:
        """Share of the excess RMSE that is gone, in the channel with the most excess over its floor."""
        channels = self.result["channels"].values()
        worst = max(channels, key=lambda c: c["refit"] / c["noise_floor"])
        return float((worst["refit"] - worst["with_effects"]) / max(worst["refit"] - worst["noise_floor"], 1e-9))


def run(drive: Drive) -> Case:
    """Diagnose one drive."""
    np.seterr(all="ignore")
    start = time.perf_counter()
    extra = ("flap",) if "flap" in drive.columns else ()
    log = DriveLog(drive.columns, np.zeros(len(drive.columns["t"]), np.int64), extra=extra)
    prior = {"cx": 50000.0, "bf": 9.0, "cf": 1.35, "df": 1.3567, "br": 10.0, "cr": 1.4, "dr": 1.3392}
    result = as_json(diagnose(make_record(log, Vehicle()), "per_axle", prior), "", "")
    return Case(drive.effects, drive.seed, result, time.perf_counter() - start)


def cases_of(names: list[str], seeds: int, pairs: int) -> list[dict[str, float]]:
    """Effects of every drive of the campaign."""
    rng = np.random.default_rng(2026)
    cases: list[dict[str, float]] = [{} for _ in range(seeds)] if "none" in names else []
    for name, _ in itertools.product([n for n in names if n != "none"], range(seeds)):
        cases.append({name: draw_size(name, rng), **NEEDS_ANOTHER.get(name, {})})
    cases.extend({name: draw_size(name, rng) for name in pair} for pair in PAIRS[:pairs])
    return cases


def report(cases: list[Case]) -> dict[str, Any]:
    """Print the confusion matrix and the figures of merit; returns them."""
    groups: dict[str, list[Case]] = defaultdict(list)
    for case in cases:
        groups[case.label].append(case)
    print(f"{'simulated':34s} {'right':>6s} {'alone':>6s} {'size error':>11s} {'sigmas':>7s} {'removed':>8s}  found")
    for label, group in groups.items():
        sizes = [s for s in (c.size_error() for c in group) if s]
        size = f"{max(s for s, _ in sizes):10.1%} {max(z for _, z in sizes):7.1f}" if sizes else " " * 18
        found = Counter(" + ".join(c.named) or c.result["verdict"] for c in group)
        print(
            f"{label:34s} {_count([c.right for c in group])} {_count([c.alone for c in group])} {size}"
            f" {np.median([c.removed() for c in group]):8.2f}  {dict(found)}"
        )  # fmt: skip
    single = [c for c in cases if len(c.effects) == 1 and not set(c.effects) & set(OUTSIDE)]
    outside = [c for c in cases if set(c.effects) & set(OUTSIDE)]
    figures = {
        "none_right": _share([c.right for c in cases if not c.effects]),
        "single_named_first": _share([c.right for c in single]),
        "single_alone": _share([c.alone for c in single]),
        "pairs_both_named": _share([c.right for c in cases if len(c.effects) > 1]),
        "outside_right": _share([c.right for c in outside]),
        "outside_removed_60": _share([c.removed() >= 0.6 for c in outside]),
        "seconds_median": float(np.median([c.seconds for c in cases])),
    }
    print(json.dumps(figures))
    return figures


def _count(flags: list[bool]) -> str:
    return f"{sum(flags):3d}/{len(flags):<2d}"


def _share(flags: list[bool]) -> float | None:
    return round(float(np.mean(flags)), 3) if flags else None


def main() -> None:
    """Run the campaign."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first-seed", type=int, default=1000)
    parser.add_argument("--only", nargs="*", default=["none", *SIZES])
    parser.add_argument("--pairs", type=int, default=len(PAIRS))
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    wanted = cases_of(arguments.only, arguments.seeds, arguments.pairs)
    done: list[Case] = []
    with ProcessPoolExecutor(arguments.workers) as pool:
        for start in range(0, len(wanted), BATCH):
            batch = wanted[start : start + BATCH]
            seeds = [arguments.first_seed + start + i for i in range(len(batch))]
            for case in pool.map(run, simulate(batch, seeds)):
                done.append(case)
                found = case.named or case.result["verdict"]
                print(f"{len(done)}/{len(wanted)} {case.label}: {found}", file=sys.stderr)
    figures = report(done)
    if arguments.json:
        rows = [{"effects": c.effects, "seed": c.seed, "right": c.right, "result": c.result} for c in done]
        arguments.json.write_text(json.dumps({"figures": figures, "cases": rows}))


if __name__ == "__main__":
    main()
