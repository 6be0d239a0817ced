"""Laps of cars with one effect more than their data sheet knows, or that do not learn, over the least lap time of that
very car.

    python -m benchmarks.campaign.undeclared [--cases undeclared] [--tracks DIR] [--seeds 830,831]

Cars, tracks, laps and effects are those of `benchmarks/cases/laps.json`; one line of JSON a car, as soon as it is
through. Every
figure comes from the plant and the referee; nothing that drives hears of the car.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from benchmarks.campaign.laps import SLOWEST, START_S, figures
from benchmarks.driving.random_car import random_car
from hil_gateway.config import load_config
from hil_gateway.plant.referee.lap_limit import lap_limit
from hil_gateway.track.loading import load_track
from planner.simulation.loop import Loop

CASES = Path(__file__).parents[1] / "cases" / "laps.json"


def track_of(case: dict[str, Any], tracks: Path) -> str:
    """Name of a shipped track, or its file."""
    return str(tracks / case["track"]) if case["track"].endswith(".csv") else str(case["track"])


def drive(case: dict[str, Any], tracks: Path) -> dict[str, Any]:
    """Drive one case, learning on where it does not say otherwise."""
    seed, laps, path = case["seed"], case["laps"], track_of(case, tracks)
    car, track = random_car(seed).model_copy(update={"effects": case["effects"]}), load_track(path)
    limit_s = lap_limit(car.parameters(), track).limit_s
    settings = {"track": path, "plant.seed": seed, "estimator.learn": case.get("learn", True)}
    loop = Loop(load_config(None, settings), track=track, simulated=car)
    result = loop.run(laps=laps, time_limit_s=laps * SLOWEST * limit_s + START_S)
    return {**case, "limit_s": round(limit_s, 3), **figures(result, limit_s)}


def main() -> None:
    """Print a line a car."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", default="undeclared", help=f"list of {CASES.name} to drive")
    parser.add_argument("--tracks", type=Path, default=Path(), help="folder of the track files")
    parser.add_argument("--seeds", default="", help="these cars alone, with commas")
    asked = parser.parse_args()
    lists = json.loads(CASES.read_text())
    if "cars" not in lists.get(asked.cases, ()):
        parser.error(f"--cases {asked.cases}: {CASES.name} has no such list of cars")
    cases = lists[asked.cases]["cars"]
    chosen = [case for case in cases if not asked.seeds or str(case["seed"]) in asked.seeds.split(",")]
    if not chosen:
        parser.error(f"--seeds {asked.seeds}: none of them is among those of {CASES.name}")
    for path in {track_of(case, asked.tracks) for case in chosen if case["track"].endswith(".csv")}:
        if not Path(path).exists():
            parser.error(f"{path}: not there; say with --tracks where the track files are")
    for case in chosen:
        print(json.dumps(drive(case, asked.tracks)), flush=True)


if __name__ == "__main__":
    main()
