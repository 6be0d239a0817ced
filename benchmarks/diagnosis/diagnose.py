"""Campaign over practice drives: every effect by seeds, confusion matrix, sizes, error removed.

    python -m benchmarks.diagnosis.diagnose [--seeds N] [--first-seed N] [--only NAME ...] [--pairs] [--json FILE]
    python -m benchmarks.diagnosis.diagnose --cases benchmarks/cases/diagnose.json

A list of cases may ask for several effects, another course, number of laps or rate of the log, and for a vehicle file
with wrong numbers: `{"effects": [], "seed": 1, "course": "oval", "laps": 5, "rate_hz": 50, "wrong": {"lf": 0.9}}`,
for another car (`"car": {"mass": 900}`), other `"noise"`, and a log `"without"` columns.

The drives come from `practice/`, whose equations are independent of the estimator's model. A single effect
counts as right when it is named first, as alone when nothing else is named; outside the catalogue the verdict
must be `unexplained` with the right channel and signal.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
import time
import zlib
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.practice import COLUMNS, LAPS, OUTSIDE, SIZES, Drive, draw_size, simulate
from benchmarks.practice.car import Chassis
from estimator.drive_log.derived import add_missing_channels
from estimator.drive_log.table import DriveLog
from estimator.offline.diagnosis import diagnose
from estimator.offline.health import examine
from estimator.offline.record.record import make_record
from estimator.offline.report.diagnosis_result import as_json
from hil_gateway.car.car import load_car
from hil_gateway.car.vehicle import Vehicle

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
    "steer_play": "gap",
    "imu_misalignment": "angle", "imu_lever_arm": "x", "yaw_damping": "k", "turn_asymmetry": "k",
    "load_sensitivity": "k", "road_grade": "rms", "road_bank": "rms",
}  # fmt: skip
PROFILE_RMS = {"road_grade": np.sqrt(0.29), "road_bank": np.sqrt(0.26)}
"""of the profiles of `practice.car` for a size of 1"""
NOT_TOLD = {"lr", "mass"}
"""A place of the centre of gravity is reported as `lf`, at the declared wheelbase; motion does not tell the mass."""
FACTORS = {"steer_scale": "scale", "speed_scale": "scale"}


@dataclass(frozen=True)
class Wanted:
    """A drive to be simulated and diagnosed.

    Attributes:
        wrong: factors on numbers of the vehicle file; without: columns that the log has not.
        noise: of the sensors, relative to `practice.drive.NOISE`.
    """

    effects: dict[str, float]
    seed: int
    course: str = "road"
    laps: int = LAPS
    rate_hz: float = 100.0
    wrong: Mapping[str, float] = field(default_factory=dict)
    chassis: Chassis = field(default_factory=Chassis)
    noise: float = 1.0
    without: tuple[str, ...] = ()

    @property
    def vehicle(self) -> Vehicle:
        """The vehicle file that is declared."""
        car = self.chassis
        numbers = {"mass": car.mass, "yaw_inertia": car.inertia, "lf": car.lf, "lr": car.lr}
        return load_car().vehicle.model_copy(
            update={name: value * self.wrong.get(name, 1.0) for name, value in numbers.items()}
        )

    @property
    def batch(self) -> tuple[str, int]:
        """Drives for which this is the same are simulated side by side."""
        return self.course, self.laps


@dataclass(frozen=True)
class Case:
    """One diagnosed drive."""

    wanted: Wanted
    result: dict[str, Any]
    seconds: float
    """of processor time"""

    @property
    def effects(self) -> dict[str, float]:
        """Simulated effects and their sizes."""
        return self.wanted.effects

    @property
    def label(self) -> str:
        """What was simulated."""
        return " + ".join((*sorted(self.effects), *(f"wrong {name}" for name in self.wanted.wrong))) or "none"

    @property
    def named(self) -> list[str]:
        """What was found."""
        return [e["name"] for e in self.result["effects"]]

    @property
    def ids(self) -> set[str]:
        """Ids that would be the right answer; a variant counts as its id."""
        return {name.partition("/")[0] for name in self.effects}

    @property
    def right(self) -> bool:
        """Whether the verdict is the right one."""
        wanted = self.ids
        if self.wanted.wrong:
            corrected = {datum["name"] for datum in self.result["vehicle"]}
            return corrected == set(self.wanted.wrong) - NOT_TOLD and wanted <= set(self.named)
        if not wanted:
            return bool(self.result["verdict"] == "none")
        if outside := wanted & set(OUTSIDE):
            channels, signals = OUTSIDE[next(iter(outside))]
            if not channels:
                return sorted(self.named) == sorted(wanted - outside) and not self.result["unexplained"]
            return any(u["channel"] in channels and u["signal"] in signals for u in self.result["unexplained"])
        return wanted <= set(self.named) if len(wanted) > 1 else self.named[:1] == list(wanted)

    @property
    def alone(self) -> bool:
        """Right, with nothing else named."""
        if set(self.effects) & set(OUTSIDE):
            return self.right and not self.named
        return self.right and set(self.named) == self.ids and not self.result["unexplained"]

    def size_error(self) -> tuple[float, float] | None:
        """Relative error of the main parameter, and in standard deviations, for a single effect that has one."""
        if not self.right or self.ids & set(OUTSIDE) or not self.effects:
            return None
        (name, size), found = next(iter(self.effects.items())), self.result["effects"]
        key = MAIN.get(name) or FACTORS.get(name)
        if key is None:
            return None
        parameter = next(e for e in found if e["name"] == name)["parameters"][key]
        size = size * PROFILE_RMS.get(name, 1.0)
        error = parameter["value"] - (1.0 + size if name in FACTORS else size)
        return abs(error / size), abs(error) / parameter["std"]

    def removed(self) -> float:
        """Share of the excess RMSE that is gone, in the channel with the most excess over its floor."""
        channels = self.result["channels"].values()
        worst = max(channels, key=lambda c: c["refit"] / c["noise_floor"])
        return float((worst["refit"] - worst["with_effects"]) / max(worst["refit"] - worst["noise_floor"], 1e-9))


def run(wanted: Wanted, drive: Drive) -> Case:
    """Diagnose one drive."""
    np.seterr(all="ignore")
    start = time.process_time()
    extra = tuple(name for name in COLUMNS if name in drive.columns)
    segment = np.zeros(len(drive.columns["t"]), np.int64)
    logged = {name: column for name, column in drive.columns.items() if name not in wanted.without}
    columns, derived = add_missing_channels(Path(), logged, segment)
    log, vehicle = DriveLog(columns, segment, derived, extra=extra), wanted.vehicle
    prior = {"cx": 50000.0, "bf": 9.0, "cf": 1.35, "df": 1.3567, "br": 10.0, "cr": 1.4, "dr": 1.3392}
    health = examine(log, vehicle)
    result = as_json(diagnose(make_record(health.log, vehicle, health.doubtful), "per_axle", prior), "", "")
    return Case(wanted, result, time.process_time() - start)


def cases_of(names: list[str], first_seed: int, seeds: int, pairs: bool) -> list[Wanted]:
    """Effects and seed of every drive of the campaign; those of a name do not depend on which others are run."""
    groups = [() if name == "none" else (name,) for name in names]
    cases = []
    for group, seed in itertools.product([*groups, *(PAIRS if pairs else ())], range(first_seed, first_seed + seeds)):
        cases.append(Wanted(*drawn(group, seed)))
    return cases


def drawn(group: Sequence[str], seed: int) -> tuple[dict[str, float], int]:
    """Effects with sizes, and the seed of the drive."""
    own = seed * 1000 + zlib.crc32(" ".join(group).encode()) % 1000
    rng = np.random.default_rng(own)
    needed = NEEDS_ANOTHER.get(group[0], {}) if len(group) == 1 else {}
    return {name: draw_size(name, rng) for name in group} | needed, own


def listed(path: Path, key: str) -> list[Wanted]:
    """The cases of a list in a file."""
    cases = json.loads(path.read_text())[key]
    return [
        Wanted(*drawn(case.pop("effects"), case.pop("seed")), chassis=Chassis(**case.pop("car", {})), **case)
        for case in cases
    ]


def report(cases: list[Case]) -> None:
    """Print the confusion matrix and the figures of merit."""
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
        "names_not_there": sorted(name for c in cases for name in set(c.named) - c.ids),
        "outside_removed_60": _share([c.removed() >= 0.6 for c in outside]),
        "cpu_seconds_p50_p90": [round(float(np.quantile([c.seconds for c in cases], q)), 1) for q in (0.5, 0.9)],
    }
    print(json.dumps(figures))


def _count(flags: list[bool]) -> str:
    return f"{sum(flags):3d}/{len(flags):<2d}"


def _share(flags: list[bool]) -> float | None:
    return round(float(np.mean(flags)), 3) if flags else None


def line(case: Case) -> str:
    """One line on a finished case."""
    size = case.size_error()
    said = [*case.named, *(f"{u['signal']} in {u['channel']}" for u in case.result["unexplained"])]
    return (
        f"{'alone' if case.alone else 'right' if case.right else 'WRONG'} {case.label} {case.effects}"
        f" seed {case.wanted.seed} {case.wanted.batch} {case.wanted.rate_hz:g} Hz:"
        f" {said or case.result['verdict']}, size off {f'{size[0]:.1%} {size[1]:.1f} sd' if size else '-'},"
        f" removed {case.removed():.2f}, {case.seconds:.0f} s"
    )  # fmt: skip


def row(case: Case) -> dict[str, Any]:
    """A finished case for the JSON file."""
    asked = {
        "label": case.label,
        "effects": case.effects,
        "seed": case.wanted.seed,
        "batch": case.wanted.batch,
        "rate_hz": case.wanted.rate_hz,
    }
    found = {"right": case.right, "alone": case.alone, "not_there": sorted(set(case.named) - case.ids)}
    return asked | found | {"seconds": case.seconds, "result": case.result}


def drives(wanted: Sequence[Wanted]) -> Iterator[Drive]:
    """Simulate in batches, in order."""
    for (course, laps), group in itertools.groupby(wanted, lambda w: w.batch):
        alike = list(group)
        for start in range(0, len(alike), BATCH):
            asked = ((w.effects, w.seed, 1.0 / w.rate_hz, w.chassis, w.noise) for w in alike[start : start + BATCH])
            effects, seeds, steps, chassis, noise = zip(*asked, strict=True)
            yield from simulate(effects, seeds, laps, course=course, log_step=steps, chassis=chassis, noise=noise)


def main() -> None:
    """Run the campaign."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first-seed", type=int, default=1000)
    parser.add_argument("--only", nargs="*", default=["none", *SIZES])
    parser.add_argument("--pairs", action="store_true")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--json", type=Path, help="written anew after every case")
    parser.add_argument("--cases", type=Path, help="a file with lists of cases instead")
    parser.add_argument("--list", default="cases", help="which of them")
    arguments = parser.parse_args()
    of_options = arguments.only, arguments.first_seed, arguments.seeds, arguments.pairs
    wanted = listed(arguments.cases, arguments.list) if arguments.cases else cases_of(*of_options)
    done: list[Case] = []
    with ProcessPoolExecutor(arguments.workers) as pool:
        for case in pool.map(run, wanted, drives(wanted)):
            done.append(case)
            print(f"{len(done)}/{len(wanted)} {line(case)}", file=sys.stderr, flush=True)
            if arguments.json:
                arguments.json.write_text(json.dumps([row(case) for case in done]))
    report(done)


if __name__ == "__main__":
    main()
