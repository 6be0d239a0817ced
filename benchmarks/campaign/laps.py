"""Laps of cars nobody has driven, with and without learning, over the least lap time of that very car.

A trial is one car on one track, in one process on virtual time. Loads, wheels off the road and lap times come from the
plant; the limit is the referee's (`hil plan limit`). Nothing that drives hears of the car or of its limit.
"""

from __future__ import annotations

import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

from benchmarks.campaign.run import Job
from benchmarks.driving.random_car import random_car
from hil_gateway.bus.messages import ModelRevision
from hil_gateway.bus.topics import MODEL_REVISION
from hil_gateway.config import Config, load_config
from hil_gateway.plant.car_file import SimulatedCar, read_car
from hil_gateway.plant.referee.lap_limit import lap_limit, lap_ratios
from hil_gateway.track.loading import load_track
from planner.node import Planner
from planner.problem.load_limits import store_limits
from planner.simulation.loop import Loop, LoopResult

SLOWEST = 4.0
"""times the limit: slower laps end a drive"""
START_S = 30.0
"""s beyond that, for arming and the standing start"""
SECOND_SESSION_LAPS = 2


@dataclass(frozen=True)
class LapsTrial:
    """One car on one track; `car` is the content of a car file, or None for the random car of the seed."""

    seed: int
    track: str
    laps: int
    car: dict[str, Any] | None = None
    without: bool = True
    """also drive with learning switched off"""

    @property
    def name(self) -> str:
        """Name of its result file."""
        return f"laps-{self.seed:03d}-{Path(self.track).stem or 'road_course'}"

    def simulated(self) -> SimulatedCar:
        """The plant's car."""
        return random_car(self.seed) if self.car is None else SimulatedCar.model_validate(self.car)

    def job(self) -> Job:
        """This trial as the runner takes it."""
        return Job(self.name, asdict(self), partial(drive_trial, self))


def trials(seeds: Sequence[int], tracks: Sequence[str], laps: int, car: Path | None, *, without: bool) -> list[Job]:
    """Cars dealt out over the tracks in turn.

    Raises:
        InputError: an unreadable car file.
    """
    # what is usual stays out: an event without an end lasts for ever, which no file can say
    content = read_car(car).model_dump(mode="json", exclude_defaults=True) if car else None
    return [
        LapsTrial(seed, tracks[i % len(tracks)], laps, content, without=without).job() for i, seed in enumerate(seeds)
    ]


def drive_trial(trial: LapsTrial) -> dict[str, Any]:
    """Both sessions with learning and one without; keys as in the summary's `cars`."""
    car, track = trial.simulated(), load_track(trial.track)
    limit_s = lap_limit(car.parameters(), track).limit_s
    config = load_config(None, {"track": trial.track, "plant.seed": trial.seed})

    def drive(config: Config, laps: int) -> tuple[Loop, LoopResult]:
        loop = Loop(config, keep=(MODEL_REVISION,), track=track, simulated=car)
        return loop, loop.run(laps=laps, time_limit_s=laps * SLOWEST * limit_s + START_S)

    loop, result = drive(config, trial.laps)
    with TemporaryDirectory() as folder:
        _, second = drive(second_session(config, loop, result, Path(folder)), SECOND_SESSION_LAPS)
    plain = drive(without_learning(config), trial.laps)[1] if trial.without else None
    again = lap_ratios(second.lap_times_s, limit_s)
    return {
        "settings": asdict(trial), "seed": trial.seed, "track": track.name, "limit_s": limit_s,
        **figures(result, limit_s),
        "second_session_lap_ratio": again[-1] if len(again) == SECOND_SESSION_LAPS else None,
        "second_session": figures(second, limit_s),
        "effects": effects_of(result),
        "without_learning": figures(plain, limit_s) if plain else None,
    }  # fmt: skip


def figures(result: LoopResult, limit_s: float) -> dict[str, Any]:
    """What the plant says of a drive."""
    return {
        "lap_times_s": [round(t, 3) for t in result.lap_times_s],
        "lap_ratio": lap_ratios(result.lap_times_s, limit_s),
        "off_track": result.off_track,
        "spins": result.spins,
        "friction_over_s": round(result.friction_over_s, 3),
        "slides": result.slides,
        "friction_used": [round(used, 3) for used in result.friction_used],
        "worst_margin_m": round(result.worst_margin_m, 3),
        "peak_speed": round(result.peak_speed, 2),
        "plan_failures": result.plan_failures,
        "failsafes": [list(entry) for entry in result.failsafes],
    }


def without_learning(config: Config) -> Config:
    """The same planner with the model and the limits it starts with."""
    return config.model_copy(update={"estimator": config.estimator.model_copy(update={"learn": False})})


def second_session(config: Config, loop: Loop, result: LoopResult, folder: Path) -> Config:
    """The next session: it has the model and the load limits the first one left behind, and other sensor noise."""
    assert isinstance(loop.planner, Planner)
    revisions = [m for m in result.messages[MODEL_REVISION.key] if isinstance(m, ModelRevision)]
    model, limits = folder / "model.json", folder / "limits.json"
    model.write_text(revisions[-1].model_dump_json())
    store_limits(limits, loop.planner.next_limits())
    return config.model_copy(update={
        "planner": config.planner.model_copy(update={"model": str(model), "load_limits": str(limits)}),
        "estimator": config.estimator.model_copy(update={"model": str(model)}),
        "plant": config.plant.model_copy(update={"seed": config.plant.seed + 1000}),
    })  # fmt: skip


def effects_of(result: LoopResult) -> dict[str, dict[str, float]]:
    """Effects of the last model revision with their parameters."""
    last = next((m for m in reversed(result.messages[MODEL_REVISION.key]) if isinstance(m, ModelRevision)), None)
    return {} if last is None else {e.name: dict(e.parameters) for e in last.effects}


def summarise(cars: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Summary of `hil campaign laps --json`; a lap counts for the median where a car has driven it."""
    laps = max((len(car["lap_ratio"]) for car in cars), default=0)
    ratios = {
        str(n): round(median(car["lap_ratio"][n - 1] for car in cars if len(car["lap_ratio"]) >= n), 4)
        for n in range(1, laps + 1)
    }
    again = [car["second_session_lap_ratio"] for car in cars if car["second_session_lap_ratio"] is not None]
    return {
        "cars": list(cars),
        "median_ratio": ratios,
        "median_second_session_ratio": round(median(again), 4) if again else None,
        "off_track": sum(car["off_track"] for car in cars),
        "spins": sum(car["spins"] for car in cars),
        "slides": sum(car["slides"] for car in cars),
        "laps_missing": sum(_laps_missing(car) for car in cars),
        "commit": commit(),
    }


def _laps_missing(car: Mapping[str, Any]) -> int:
    """Laps that were asked for and not driven, of all sessions."""
    laps = car["settings"]["laps"]
    asked = {"first": laps, "second": SECOND_SESSION_LAPS, "plain": laps}
    driven = {"first": car, "second": car["second_session"], "plain": car["without_learning"]}
    return sum(max(asked[name] - len(d["lap_times_s"]), 0) for name, d in driven.items() if d is not None)


def commit() -> str:
    """Commit the figures were made with; empty outside a checkout."""
    command = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty", "--abbrev=12"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=10).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return ""
