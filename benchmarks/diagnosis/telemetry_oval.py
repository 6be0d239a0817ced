"""Diagnosis and identification of a banked oval as a car's own logger records it, where the truth is known.

    python -m benchmarks.diagnosis.telemetry_oval [--only NAME ...] [--json FILE]

The car is the double-track one of `practice/`, its log is degraded as measured ones are (`practice/telemetry.py`).
Drives, seeds and what is asked were fixed before the first run. Every log is also diagnosed by halves: a size that one
states beyond what the other allows is a contradiction.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table
from typer import Typer
from typer.testing import CliRunner

from benchmarks.practice.double_track import Setup
from benchmarks.practice.double_track_drive import simulate
from benchmarks.practice.telemetry import telemetry
from estimator.cli.diagnose import app as diagnose_command
from estimator.cli.identify import app as identify_command
from hil_gateway.process.arrays import Array


@dataclass(frozen=True)
class Case:
    """One log: the car and its road, seed, whether it has ay, and the sign of its roll."""

    setup: Setup
    seed: int
    ay: bool
    roll_sign: float


STEEP = Setup(course="oval", bank=math.radians(20), fastest=65.0, laps=8)
CASES = {
    "no ay": Case(STEEP, 81, ay=False, roll_sign=1.0),
    "no ay, other sign of roll": Case(STEEP, 82, ay=False, roll_sign=-1.0),
    "ay at its sensor": Case(STEEP, 83, ay=True, roll_sign=1.0),
    "flat, no ay": Case(Setup(course="oval", fastest=65.0, laps=8), 84, ay=False, roll_sign=1.0),
    "ay at its sensor, again": Case(STEEP, 181, ay=True, roll_sign=-1.0),
    "ay at its sensor, 14 deg": Case(
        Setup(course="oval", bank=math.radians(14), fastest=60.0, laps=8), 182, ay=True, roll_sign=1.0
    ),
    "flat, no ay, again": Case(Setup(course="oval", fastest=65.0, laps=8), 183, ay=False, roll_sign=1.0),
    "flat, ay at its sensor": Case(Setup(course="oval", fastest=65.0, laps=8), 184, ay=True, roll_sign=1.0),
    "no ay, 16 deg": Case(
        Setup(course="oval", bank=math.radians(16), fastest=62.0, laps=8), 281, ay=False, roll_sign=-1.0
    ),
    "ay at its sensor, 18 deg": Case(
        Setup(course="oval", bank=math.radians(18), fastest=64.0, laps=8), 282, ay=True, roll_sign=1.0
    ),
    "ay at its sensor, 10 deg": Case(
        Setup(course="oval", bank=math.radians(10), fastest=58.0, laps=8), 283, ay=True, roll_sign=-1.0
    ),
    "flat, no ay, third": Case(Setup(course="oval", fastest=65.0, laps=8), 284, ay=False, roll_sign=1.0),
    "ay at its sensor, 17 deg": Case(
        Setup(course="oval", bank=math.radians(17), fastest=63.0, laps=8), 381, ay=True, roll_sign=-1.0
    ),
    "no ay, 12 deg": Case(
        Setup(course="oval", bank=math.radians(12), fastest=59.0, laps=8), 382, ay=False, roll_sign=1.0
    ),
    "flat, slow, ay at its sensor": Case(Setup(course="oval", fastest=50.0, laps=8), 383, ay=True, roll_sign=1.0),
    "flat, fast, no ay": Case(Setup(course="oval", fastest=72.0, laps=8), 384, ay=False, roll_sign=-1.0),
    "no ay, 15 deg, slow": Case(
        Setup(course="oval", bank=math.radians(15), fastest=54.0, laps=8), 481, ay=False, roll_sign=-1.0
    ),
    "ay at its sensor, 11 deg": Case(
        Setup(course="oval", bank=math.radians(11), fastest=66.0, laps=8), 482, ay=True, roll_sign=1.0
    ),
    "flat, 58 m/s, no ay": Case(Setup(course="oval", fastest=58.0, laps=8), 483, ay=False, roll_sign=1.0),
    "flat, 69 m/s, ay at its sensor": Case(Setup(course="oval", fastest=69.0, laps=8), 484, ay=True, roll_sign=-1.0),
}
"""The first four are the list. The next four were fixed before the rules that the third and fourth led to, the third
four after the sensor of vy was estimated with the tyres beside an accelerometer, the fourth four before the axle load
moved by ax was estimated with the tyres, the last four before any change to what is taken out of vy and yaw rate and to
what halves may state; all before their first run.
"""
LEFT_AY, LEFT_YAW_RATE = 0.12, 0.0070
"""m/s2 that a diagnosis may leave with catalogue effects, at most 1.25 times noise; rad/s of `hil identify`"""
BANK_WITHIN = 0.15
"""Relative error of the largest bank."""
NEVER = {"speed_scale"}
"""names of what no log of these has"""
CONTRADICTED = 3.0
"""Standard errors by which halves may differ."""


def drive_logs(cases: Iterable[Case]) -> list[dict[str, Array]]:
    """Columns of the logs; the cars drive side by side."""
    wanted = list(cases)
    drives = simulate([case.setup for case in wanted], [case.seed for case in wanted], with_bank=True)
    return [telemetry(d, c.seed, ay=c.ay, roll_sign=c.roll_sign) for d, c in zip(drives, wanted, strict=True)]


def said(command: Typer, columns: Mapping[str, Array], folder: Path) -> dict[str, Any]:
    """What a command says of a log, as JSON."""
    path = folder / "oval.csv"
    np.savetxt(path, np.column_stack(list(columns.values())), "%.7g", ",", header=",".join(columns), comments="")
    done = CliRunner().invoke(command, [str(path), "--json"])
    return dict(json.loads(done.stdout))


def halves(columns: Mapping[str, Array]) -> list[dict[str, Array]]:
    """The log before and after the middle of its time."""
    middle = len(columns["t"]) // 2
    return [{name: c[part] for name, c in columns.items()} for part in (slice(middle), slice(middle, None))]


def contradictions(one: Mapping[str, Any], other: Mapping[str, Any]) -> list[str]:
    """Sizes that both state and that differ beyond what both allow."""
    sizes = [
        {f"{e['name']}.{p}": v for e in found["effects"] for p, v in e["parameters"].items() if v["determined"]}
        for found in (one, other)
    ]
    both = sizes[0].keys() & sizes[1].keys()
    return sorted(
        key for key in both
        if abs(sizes[0][key]["value"] - sizes[1][key]["value"])
        > CONTRADICTED * math.hypot(sizes[0][key]["std"], sizes[1][key]["std"])
    )  # fmt: skip


def results(cases: Mapping[str, Case]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Every log with what is said of it, and of its halves."""
    with TemporaryDirectory() as folder:
        for name, log in track(list(zip(cases, drive_logs(cases.values()), strict=True)), "diagnosing"):
            whole, *parts = (said(diagnose_command, part, Path(folder)) for part in (log, *halves(log)))
            yield name, {"whole": whole, "halves": parts, "identified": said(identify_command, log, Path(folder))}


def row(name: str, case: Case, found: Mapping[str, Any]) -> list[str]:
    """One line of the table."""
    whole = found["whole"]
    ay, yaw = whole["channels"]["ay"], found["identified"]["rmse"]["yaw_rate"]["final"]
    names = [[e["name"] for e in one["effects"]] for one in (whole, *found["halves"])]
    most = max(LEFT_AY, 1.25 * ay["noise_floor"])
    return [
        name, whole["verdict"], f"{ay['catalogue']:.3f}{'' if ay['catalogue'] <= most else f' > {most:.3f}'}",
        f"{yaw:.4f}{'' if yaw <= LEFT_YAW_RATE else f' > {LEFT_YAW_RATE}'}", _bank(case, whole),
        *(", ".join(own) + (" NEVER THERE" if NEVER & set(own) else "") for own in names),
        ", ".join(contradictions(*found["halves"])) or "-",
    ]  # fmt: skip


def _bank(case: Case, whole: Mapping[str, Any]) -> str:
    """The largest bank found, deg, and whether it is right."""
    found = [e["parameters"] for e in whole["effects"] if e["name"] == "road_bank"]
    true = np.degrees(case.setup.bank)
    if not found:
        return "-" if not true else f"not named, {true:.0f}"
    size = max(abs(np.degrees(found[0][n]["value"])) for n in ("largest", "smallest"))
    return f"{size:.1f} of {true:.0f}{'' if abs(size - true) <= BANK_WITHIN * true else ' WRONG'}"


def main() -> None:
    """Run the logs and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="*", default=list(CASES), choices=list(CASES))
    parser.add_argument("--json", type=Path, help="every result")
    arguments = parser.parse_args()
    done = dict(results({name: CASES[name] for name in arguments.only}))
    table = Table("log", "verdict", "ay", "yaw rate", "bank, deg", "named", "first half", "second half", "contradicted")
    for name, found in done.items():
        table.add_row(*row(name, CASES[name], found))
    Console(width=200).print(table)
    if arguments.json:
        arguments.json.write_text(json.dumps(done))


if __name__ == "__main__":
    main()
