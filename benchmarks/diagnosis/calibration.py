"""Whether what a diagnosis states is true as often as it says, over drives drawn at random.

    python -m benchmarks.diagnosis.calibration --list effects --drives 36 --first 0 --out DIR

`effects`: none to three effects of sensible size on one car, a road course or an oval, 4 to 8 laps, 25 to 200 rows a
second. `cars`: the same with another car, tyres, noise and vehicle file each, open circles, 3 to 20 laps, and columns
that are missing. `double_track`: cars of `practice/double_track.py`. All is drawn from the number of the drive; course,
laps and rate are the same for `SIDE_BY_SIDE` drives, which are simulated together and stored in DIR, so that a run
that was stopped goes on. Of what is stated `DIR/report.html` says how often it holds (`calibration_report`).
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.campaign.run import Job, Machines, drive_all

# the project before its benchmarks, one of which is called `planner` too; processes that drive have the same path
from benchmarks.diagnosis import double_track
from benchmarks.diagnosis.calibration_report import summary, write_report
from benchmarks.diagnosis.diagnose import FACTORS, MAIN, NEEDS_ANOTHER, PROFILE_RMS, Wanted, drives, run
from benchmarks.practice import SIZES, draw_size
from benchmarks.practice.car import TYRE, Chassis
from benchmarks.practice.double_track import Setup
from estimator.offline.fit.fixed_parameters import INERTIA_ERROR, MASS_ERROR, PLACE_ERROR

ROOTS = {"effects": 8100, "cars": 8200, "double_track": 8300}
"""of all draws; nothing is tuned on these drives"""
EFFECTS = tuple(name for name in MAIN if name in SIZES) + tuple(FACTORS)
"""of the catalogue, in its own form, with a size that a diagnosis states"""
HOW_MANY = (0.2, 0.4, 0.3, 0.1)
"""probabilities of none to three effects"""
RATES_HZ = (25.0, 50.0, 100.0, 200.0)
SIDE_BY_SIDE = 12
"""drives of one course, number of laps and rate: to simulate many takes as long as to simulate one"""
MISSING: tuple[tuple[str, ...], ...] = ((), (), (), ("ax",), ("ay",), ("x", "y", "lap"), ("lap",))
"""columns that a log may lack, each as likely"""


def drawn_effects(rng: np.random.Generator) -> dict[str, float]:
    """None to three effects with sizes."""
    names = [str(n) for n in rng.choice(EFFECTS, size=rng.choice(len(HOW_MANY), p=HOW_MANY), replace=False)]
    effects = {name: draw_size(name, rng) for name in names}
    for name in names:
        effects = NEEDS_ANOTHER.get(name, {}) | effects
    return effects


def of_one_car(number: int) -> Wanted:
    """The drive of this number in `effects`."""
    root = ROOTS["effects"]
    effects = drawn_effects(np.random.default_rng([root, number]))
    alike = np.random.default_rng([root, number // SIDE_BY_SIDE, 1])
    course, laps, rate = alike.choice(["road", "oval"]), int(alike.integers(4, 9)), float(alike.choice(RATES_HZ))
    return Wanted(effects, root * 1000 + number, course=str(course), laps=laps, rate_hz=rate)


def of_any_car(number: int) -> Wanted:
    """The drive of this number in `cars`."""
    root = ROOTS["cars"]
    rng = np.random.default_rng([root, number])
    effects, chassis, noise = drawn_effects(rng), drawn_car(rng), float(np.exp(rng.uniform(*np.log([0.5, 2.0]))))
    without, wrong = MISSING[rng.integers(len(MISSING))], drawn_errors(chassis, rng)
    alike = np.random.default_rng([root, number // SIDE_BY_SIDE, 1])
    course, rate = str(alike.choice(["road", "oval", "circle"])), float(alike.choice(RATES_HZ))
    laps = int(np.exp(alike.uniform(*np.log([12.0 if course == "circle" else 3.0, 21.0]))))
    return Wanted(effects, root * 1000 + number, course, laps, rate, wrong, chassis, noise, without)


def drawn_car(rng: np.random.Generator) -> Chassis:
    """A car between a formula and a touring car, with tyres of its own."""
    mass, wheelbase = rng.uniform(600.0, 1300.0), rng.uniform(2.6, 3.1)
    lf = wheelbase * rng.uniform(0.46, 0.6)
    factors = {name: rng.uniform(0.85, 1.15) for name in ("bf", "br")} | {"cx": mass / 787.3 * rng.uniform(0.8, 1.2)}
    grip = rng.uniform(0.97, 1.12)
    factors |= {"df": grip, "dr": grip * rng.uniform(0.98, 1.05)}
    tyre = {name: value * float(factors.get(name, 1.0)) for name, value in TYRE.items()}
    return Chassis(float(mass), float(mass * rng.uniform(1.1, 1.6)), float(lf), float(wheelbase - lf), tyre)


def drawn_errors(chassis: Chassis, rng: np.random.Generator) -> dict[str, float]:
    """Factors on the numbers of the vehicle file: it knows the wheelbase, and the rest as well as the diagnosis counts
    on; what a worse file does is for the practice list `held` to say."""
    moved = PLACE_ERROR * rng.normal()
    return {
        "mass": 1.0 + MASS_ERROR * rng.normal(), "yaw_inertia": 1.0 + INERTIA_ERROR * rng.normal(),
        "lf": 1.0 + moved / chassis.lf, "lr": 1.0 - moved / chassis.lr,
    }  # fmt: skip


def diagnosed(draw: Callable[[int], Wanted], numbers: Sequence[int]) -> list[dict[str, Any]]:
    """Practice drives with what is true of them, and what is said."""
    wanted = [draw(number) for number in numbers]
    return [_judged(one, run(one, drive).result) for one, drive in zip(wanted, drives(wanted), strict=True)]


def _judged(wanted: Wanted, result: Mapping[str, Any]) -> dict[str, Any]:
    sizes = {}
    for name, size in wanted.effects.items():
        parameter = MAIN.get(name) or FACTORS.get(name)
        if parameter is not None:
            true = 1.0 + size if name in FACTORS else size * PROFILE_RMS.get(name, 1.0)
            sizes[f"{name}.{parameter}"] = true
    if {"steer_scale", "steer_offset"} <= set(wanted.effects):  # the model scales the offset too
        sizes["steer_offset.offset"] /= sizes["steer_scale.scale"]
    label = f"{wanted.seed} {wanted.batch} {wanted.rate_hz:g} Hz {', '.join(wanted.without)}"
    there = sorted(wanted.effects)
    return {
        "label": label, "there": there, "may": [], "sizes": sizes, "tyre": wanted.chassis.tyre, "result": result
    }  # fmt: skip


def setup(number: int) -> Setup:
    """The double-track car of this number."""
    root = ROOTS["double_track"]
    rng, alike = np.random.default_rng([root, number]), np.random.default_rng([root, number // SIDE_BY_SIDE, 1])
    course, laps = str(alike.choice(["road", "oval"])), int(alike.integers(5, 9))
    oval, drag, down = course == "oval", float(rng.uniform(0.3, 0.9)), float(rng.uniform(0.6, 1.8))
    front, grip = float(rng.uniform(0.3, 0.45)), float(rng.uniform(1.45, 1.7))
    return Setup(
        course, laps, drag=drag, downforce=(down * front, down * (1 - front)),
        brake_front=float(rng.uniform(0.5, 0.65)), engine_braking=float(rng.uniform(200.0, 700.0)),
        height=float(rng.uniform(0.22, 0.4)), grip=(grip, grip * float(rng.uniform(1.02, 1.06))),
        sensitivity=float(rng.uniform(0.08, 0.16)), lock=float(rng.uniform(0.1, 0.3)),
        bank=math.radians(rng.uniform(3.0, 20.0)) if oval else float(rng.choice([0.0, rng.uniform(0.02, 0.06)])),
        grade=0.0 if oval else float(rng.choice([0.0, rng.uniform(0.02, 0.05)])),
        wind=float(rng.choice([0.0, rng.uniform(4.0, 10.0)])), fastest=75.0 if oval else 60.0,
    )  # fmt: skip


def diagnosed_double_track(numbers: Sequence[int]) -> list[dict[str, Any]]:
    """Double-track drives with what is true of them, and what is said."""
    cases = {str(n): double_track.Case(setup(n), ROOTS["double_track"] * 1000 + n, {}, ()) for n in numbers}
    found = double_track.results(cases, processes=1)
    return [_of_double_track(name, case, result) for name, case, result in found]


def _of_double_track(name: str, case: double_track.Case, result: Mapping[str, Any]) -> dict[str, Any]:
    s = case.setup
    there = list(double_track.LARGE) + ["wind"] * (s.wind > 0) + ["road_bank"] * (s.bank > 0)
    there += ["road_grade"] * (s.grade > 0)
    return {
        "label": f"{name} {s}", "there": sorted(there), "may": sorted(double_track.OF_THE_CAR),
        "sizes": double_track.sizes(case), "tyre": {}, "result": result,
    }  # fmt: skip


LISTS: Mapping[str, Callable[[Sequence[int]], list[dict[str, Any]]]] = {
    "effects": partial(diagnosed, of_one_car),
    "cars": partial(diagnosed, of_any_car),
    "double_track": diagnosed_double_track,
}


def _driven(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Drives simulated side by side, for the campaign runner."""
    return {"settings": settings, "drives": LISTS[settings["list"]](settings["numbers"])}


def jobs(of: str, first: int, count: int) -> list[Job]:
    """Drives `first` to `first + count` of a list, those side by side together."""
    groups: dict[int, list[int]] = {}
    for number in range(first, first + count):
        groups.setdefault(number // SIDE_BY_SIDE, []).append(number)
    asked: list[dict[str, Any]] = [{"list": of, "root": ROOTS[of], "numbers": numbers} for numbers in groups.values()]
    return [Job(f"{of}-{min(a['numbers']):05d}-{len(a['numbers'])}", a, partial(_driven, a)) for a in asked]


def main() -> None:
    """Run the drives that are not stored yet, and write the report."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--list", choices=list(LISTS), default="effects")
    parser.add_argument("--drives", type=int, default=60)
    parser.add_argument("--first", type=int, default=0, help="number of the first drive")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("calibration"))
    arguments = parser.parse_args()
    wanted = jobs(arguments.list, arguments.first, arguments.drives)
    results = drive_all(wanted, arguments.out, Machines(arguments.workers))
    done = [drive for result in results for drive in result["drives"]]
    for what, share in summary(done).items():
        print(f"{what}: {share.words()}")
    subtitle = f"{len(done)} drives of the list {arguments.list} from number {arguments.first} on"
    print(write_report(done, subtitle, arguments.out / "report.html"))


if __name__ == "__main__":
    main()
