"""How soon a car's own limit is known and driven: exploring against driving normally, on realistic cars.

A trial is one random car and one way of driving, on virtual time, by the limits and reserves every drive has. Success
is judged by the plant: from when on the lateral force that the model in force allows at 30, 45 and 60 m/s is within 5 %
of what the plant's own steady manoeuvres give, and from which lap on the car is within 5 % of its least lap time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np

from benchmarks.campaign.analysis import bootstrap, seconds_to
from benchmarks.campaign.driving import ADDED_SIGNAL, ExcitedBus
from benchmarks.campaign.laps import SLOWEST, START_S, commit, figures
from benchmarks.campaign.run import Job
from benchmarks.campaign.trial import METHODS
from benchmarks.driving.random_car import random_car
from estimator.belief.revision import model_of
from hil_gateway.bus.interface import Bus
from hil_gateway.bus.messages import ModelRevision
from hil_gateway.bus.topics import MODEL_REVISION
from hil_gateway.car.car import load_car
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.config import Config, load_config
from hil_gateway.plant.referee.lap_limit import lap_limit, lateral_limit
from hil_gateway.process.arrays import Array
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.track.loading import load_track
from hil_gateway.track.track import Track
from planner.line.envelope import envelope_of
from planner.node import Planner
from planner.plan.exploring import exploring
from planner.simulation.loop import START_NS, Loop

SPEEDS = (30.0, 45.0, 60.0)
"""m/s: slow and fast bends of the shipped tracks"""
KNOWN_TO = 0.05
"""error of the lateral limit, over it, within which it counts as known"""
NEAR = 1.05
"""lap time over the least one of the car within which the limit counts as driven"""


@dataclass(frozen=True)
class ExploreTrial:
    """One car, one way of driving."""

    method: str
    seed: int
    track: str
    laps: int

    @property
    def name(self) -> str:
        """Name of its result file."""
        return f"{self.method}-{self.seed:03d}"

    def job(self) -> Job:
        """This trial as the runner takes it."""
        return Job(self.name, asdict(self), partial(drive_trial, self))


def drive_trial(trial: ExploreTrial) -> dict[str, Any]:
    """Drive it; plain data."""
    car, track = random_car(trial.seed), load_track(trial.track)
    limit_s = lap_limit(car.parameters(), track).limit_s
    config = load_config(None, {"track": trial.track, "plant.seed": trial.seed})
    config = exploring(config) if trial.method == "infomax" else config
    loop = Loop(config, keep=(MODEL_REVISION,), track=track, simulated=car, components={"planner": _planner(trial)})
    result = loop.run(laps=trial.laps, time_limit_s=trial.laps * SLOWEST * limit_s + START_S)
    revisions = [m for m in result.messages[MODEL_REVISION.key] if isinstance(m, ModelRevision)]
    armed_s = loop.elapsed_s - result.seconds
    t = [(m.stamp_ns - START_NS) / NS_PER_S - armed_s for m in revisions]
    errors = limit_errors(revisions, lateral_limit(car.parameters(), SPEEDS), config.vehicle, track.length)
    return {
        "settings": asdict(trial), "limit_s": limit_s, **figures(result, limit_s), "seconds": result.seconds,
        "limit_error": {"t": np.round(t, 2).tolist(), "error": np.round(errors, 4).tolist()},
    }  # fmt: skip


def _planner(trial: ExploreTrial) -> Any:
    """Factory of the planner, with what a way of driving adds to its commands."""
    signal = ADDED_SIGNAL.get(trial.method)

    def planner(config: Config, bus: Bus, track: Track) -> Planner:
        return Planner(config, ExcitedBus(bus, signal, trial.seed) if signal else bus, track)

    return planner


def limit_errors(revisions: Sequence[ModelRevision], limit: Array, vehicle: Vehicle, lap_length: float) -> Array:
    """Largest error over `SPEEDS` of each model's lateral limit, over the car's own `limit` (3,), shape (n,)."""

    def error(revision: ModelRevision) -> float:
        revised = model_of(revision, vehicle, lap_length)
        at_start = revised.phi_at(np.zeros(1))[:, 0]
        envelope = envelope_of(revised.model, list(revised.theta), list(at_start), use=(1.0, 1.0), car=load_car())
        return float(np.max(np.abs(envelope.at(envelope.lateral, np.array(SPEEDS)) / limit - 1.0)))

    return np.array([error(revision) for revision in revisions])


def summarise(trials: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Summary of `hil campaign explore --json`: medians over cars with their 95 % bootstrap intervals."""
    methods = [m for m in METHODS if any(t["settings"]["method"] == m for t in trials)]
    plain = {t["settings"]["seed"]: t for t in trials if t["settings"]["method"] == "plain"}
    own = {m: [t for t in trials if t["settings"]["method"] == m] for m in methods}
    return {
        "known_to": KNOWN_TO, "near": NEAR, "commit": commit(),
        "methods": {m: _method(driven, plain) for m, driven in own.items()},
    }  # fmt: skip


def _method(driven: Sequence[dict[str, Any]], plain: dict[int, dict[str, Any]]) -> dict[str, Any]:
    pairs = [(t, plain[t["settings"]["seed"]]) for t in driven]
    known = [known_after(t) for t in driven]
    return {
        "cars": len(driven),
        "known_after_s": vars(bootstrap([s for s, _ in known])),
        "known": sum(reached for _, reached in known),
        "times_sooner_than_plain": vars(bootstrap([known_after(p)[0] / known_after(t)[0] for t, p in pairs])),
        "error_at_end": vars(bootstrap([t["limit_error"]["error"][-1] for t in driven])),
        "laps_to_the_limit": [laps_to_the_limit(t) for t in driven],
        "first_laps_over_plain": vars(bootstrap([_sum(t) / _sum(p) for t, p in pairs])),
        **{key: sum(t[key] for t in driven) for key in ("off_track", "spins", "plan_failures")},
        "friction_over_s": max(t["friction_over_s"] for t in driven),
        "failsafes": sum(len(t["failsafes"]) for t in driven),
    }


def known_after(trial: dict[str, Any]) -> tuple[float, bool]:
    """Seconds driven from which on the limit is known to `KNOWN_TO`; the whole drive and False where it never is."""
    error = trial["limit_error"]
    found, reached = seconds_to(np.array(error["t"]), np.array(error["error"]), KNOWN_TO, rising=False)
    return max(found, 1.0), reached


def laps_to_the_limit(trial: dict[str, Any]) -> int | None:
    """Number of the first lap within `NEAR` of the car's own limit; None where there is none."""
    return next((n for n, ratio in enumerate(trial["lap_ratio"], 1) if ratio <= NEAR), None)


def _sum(trial: dict[str, Any]) -> float:
    """Time of all its laps; of a drive that ended before, the whole time it was given."""
    done = len(trial["lap_times_s"]) == trial["settings"]["laps"]
    return float(sum(trial["lap_times_s"])) if done else float(trial["seconds"])
