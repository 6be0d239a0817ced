"""Diagnosis of a double-track car whose parameters are known, on flat, sloped, wet and banked roads.

    python -m benchmarks.diagnosis.double_track [--only NAME ...] [--json FILE]

The car (`practice/double_track.py`) shares no equation with the estimator. Its drives, their seeds and what is asked of
each were fixed before the first run: what is left on the scored laps, and names with sizes.
"""

from __future__ import annotations

import argparse
import json
import math
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmarks.practice.double_track import BRAKE_FORCE, BRAKE_PRESSURE, Setup
from benchmarks.practice.double_track_drive import simulate
from estimator.drive_log.table import DriveLog, segment_numbers
from estimator.offline.diagnosis import diagnose
from estimator.offline.health import examine
from estimator.offline.record.declared import default_tyre_prior
from estimator.offline.record.record import make_record
from estimator.offline.report.diagnosis_result import as_json
from estimator.offline.search.pool import workers
from hil_gateway.car.car import load_car

ROAD_LIMITS = {"ax": 0.30, "ay": 0.20, "yaw_acc": 0.13}
OVAL_LIMITS = {"ax": 0.22, "ay": 0.20, "yaw_acc": 0.12}
"""RMS that may be left on the scored laps, m/s2 and rad/s2"""
WET_LIMITS = {"ax": 0.30, "ay": 0.30, "yaw_acc": 0.13}
OF_THE_CAR = {
    "combined_slip", "traction_loss", "traction_load", "total_slip", "drive_saturation", "load_sensitivity",
    "tyre_relaxation", "engine_braking", "yaw_damping",
}  # fmt: skip
"""names of what this car has besides what must be named"""


@dataclass(frozen=True)
class Case:
    """One drive, what may be left of each channel, and what must be named."""

    setup: Setup
    seed: int
    limits: Mapping[str, float]
    named: tuple[str, ...]


LARGE = ("aero_drag", "aero_downforce", "load_transfer", "front_brake")
CASES = {
    "road": Case(Setup(), 71, ROAD_LIMITS, LARGE),
    "sloped road": Case(Setup(bank=0.05, grade=0.04), 72, ROAD_LIMITS, (*LARGE, "road_bank", "road_grade")),
    "wet laps": Case(Setup(wet=(3, 5, 6)), 73, WET_LIMITS, LARGE),
    "oval, 9 deg": Case(
        Setup(course="oval", bank=math.radians(9), fastest=75.0), 74, OVAL_LIMITS, (*LARGE[:3], "road_bank")
    ),
    "oval, 12 deg, wind": Case(
        Setup(course="oval", bank=math.radians(12), fastest=75.0, wind=7.0), 75, OVAL_LIMITS,
        (*LARGE[1:3], "wind", "road_bank"),
    ),
    "oval, 20 deg": Case(
        Setup(course="oval", bank=math.radians(20), fastest=81.0), 76, OVAL_LIMITS, (*LARGE[:3], "road_bank")
    ),
    "wet, laps 2, 3 and 5": Case(Setup(wet=(2, 3, 5), wet_length=0.06, wet_grip=0.75), 171, WET_LIMITS, LARGE),
    "wet, every lap": Case(Setup(wet=tuple(range(8)), wet_length=0.08, wet_grip=0.8), 172, WET_LIMITS, LARGE),
    "wet, scored laps 4 and 7": Case(Setup(wet=(4, 7)), 173, {}, LARGE),
    "wet, lap 5": Case(Setup(wet=(5,), wet_length=0.08), 174, {}, LARGE),
    "wet from lap 4 on, sloped": Case(
        Setup(wet=(4, 5, 6, 7), bank=0.03, grade=0.02, wet_length=0.07, wet_grip=0.75), 175, {},
        (*LARGE, "road_bank", "road_grade"),
    ),
    "road again": Case(Setup(), 176, ROAD_LIMITS, LARGE),
    "sloped road again": Case(Setup(bank=0.04, grade=0.03), 177, ROAD_LIMITS, (*LARGE, "road_bank", "road_grade")),
    "sloped road, third": Case(Setup(bank=0.03, grade=0.05), 271, ROAD_LIMITS, (*LARGE, "road_bank", "road_grade")),
    "oval, 15 deg": Case(
        Setup(course="oval", bank=math.radians(15), fastest=78.0), 272, OVAL_LIMITS, (*LARGE[:3], "road_bank")
    ),
}  # fmt: skip
"""The first six are the list, the next seven were fixed before the rules on stretches of other grip, the last two
before sizes beside an empirical term were looked at."""


def results(
    cases: Mapping[str, Case], processes: int = os.cpu_count() or 1
) -> Iterator[tuple[str, Case, dict[str, Any]]]:
    """Every drive with what `hil diagnose` says of it, fits in so many processes."""
    drives = simulate([case.setup for case in cases.values()], [case.seed for case in cases.values()])
    vehicle, prior = load_car().vehicle, default_tyre_prior("per_axle", load_car().vehicle, load_car())
    with workers(processes) as pool:
        for (name, case), drive in zip(cases.items(), track(drives, "diagnosing"), strict=True):
            log = DriveLog(drive.columns, segment_numbers(drive.columns["t"]))
            health = examine(log, vehicle)
            record = make_record(health.log, vehicle, health.doubtful)
            yield name, case, as_json(diagnose(record, "per_axle", prior, pool=pool), "", "")


def sizes(case: Case) -> dict[str, float]:
    """True size of what is compared: `effect.parameter` -> value."""
    s = case.setup
    return {
        "aero_drag.k": s.drag, "aero_downforce.k_front": s.downforce[0], "aero_downforce.k_rear": s.downforce[1],
        "load_transfer.height": s.height,
        "front_brake.force": s.brake_front * BRAKE_FORCE * load_car().powertrain.brake_pressure_max / BRAKE_PRESSURE,
    }  # fmt: skip


def row(name: str, case: Case, found: dict[str, Any]) -> list[str]:
    """One line of the table."""
    left = {c: found["channels"][c]["catalogue"] for c in case.limits}
    names = [e["name"] for e in found["effects"]]
    parameters = {f"{e['name']}.{p}": v for e in found["effects"] for p, v in e["parameters"].items()}
    of_true = [
        f"{key.split('.')[1]} {parameters[key]['value']:.3g}±{parameters[key]['std']:.2g} of {true:.3g}"
        for key, true in sizes(case).items() if key in parameters
    ]  # fmt: skip
    return [
        name,
        ", ".join(f"{v:.2f}{'' if v <= case.limits[c] else ' > ' + str(case.limits[c])}" for c, v in left.items()),
        ", ".join(n for n in case.named if n not in names) or "-",
        ", ".join(n for n in names if n not in case.named and n not in (*OF_THE_CAR, *LARGE)) or "-",
        ", ".join(of_true),
    ]


def main() -> None:
    """Run the drives and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="*", default=list(CASES), choices=list(CASES))
    parser.add_argument("--json", type=Path, help="every result")
    arguments = parser.parse_args()
    done = list(results({name: CASES[name] for name in arguments.only}))
    table = Table(
        "drive", "ax, ay, yaw acceleration", "not named", "not there", "sizes", title="catalogue effects alone"
    )
    for name, case, found in done:
        table.add_row(*row(name, case, found))
    Console(width=160).print(table)
    if arguments.json:
        arguments.json.write_text(json.dumps({name: found for name, _, found in done}))


if __name__ == "__main__":
    main()
