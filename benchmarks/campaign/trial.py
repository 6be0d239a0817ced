"""Learning campaign: how many samples until the tyres are known, driving to learn against driving normally.

A trial is one seed and one way of driving, closed loop on the simulated car in one process on virtual time. Each seed
is another car: every parameter of its tyres is off the declared one by the same share, up or down at random. All ways
of driving meet the same cars:

- `infomax`: Eq. (9) with the information term, until the belief is as good as the campaign asks for;
- `plain`: the same planner with q_I = 0;
- `prbs`, `sine`: the plain planner with a pseudo-random binary or a swept-sine signal added, of the largest size that
  kept all limits;
- `prior`, `learnt`: afterwards, the plain planner that learns nothing more, with the declared model known to the share
  that cars are off by, and with the model, belief and load limits that the infomax drive ended with;
- `known`: the plain planner that knows the car's tyres, one lap at their limits. No way of driving learns from it: it
  is what their beliefs are judged by.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.campaign.driving import ADDED_SIGNAL, ExcitedBus, RecordingEstimator
from benchmarks.campaign.run import Job
from benchmarks.campaign.safety import SLIP_SPEED, safety_figures
from benchmarks.plans.safety import Watch, Watched
from estimator.belief.revision import declared_revision
from estimator.belief.tyre_belief import Sample
from estimator.model.parameters import tyre_prior
from hil_gateway.bus import topics
from hil_gateway.bus.interface import Bus
from hil_gateway.bus.messages import Belief
from hil_gateway.car.car import load_car
from hil_gateway.config import Config, load_config
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.track.track import Track
from planner.node import Planner
from planner.plan.exploring import EXPLORING, exploring
from planner.problem.load_limits import LoadLimits, store_limits
from planner.simulation.loop import START_NS, Loop, LoopResult

METHODS = ("infomax", "plain", "prbs", "sine")
AFTERWARDS = ("prior", "learnt")
KNOWN = "known"
KNOWN_STD = 0.02
"""relative standard deviation of every parameter of tyres that are known"""
PROGRESS_EVERY = 20
"""plans between two notes of where the car was"""


@dataclass(frozen=True)
class CampaignSettings:
    """What is compared; two campaigns with equal settings give equal results."""

    laps: int = 1
    seconds: float = 0.0
    """learning ends so long after the car was armed, before the laps are done; 0: whole laps"""
    track: str = ""
    mismatch: float = 0.10
    """by which B, C and D of either axle are off the declared ones"""
    information_weight: float = EXPLORING["information_weight"]
    information_criterion: str = EXPLORING["information_criterion"]
    information_goal: float = 0.106
    """spread of the belief over the prior's at which exploring ends: a little beyond parameters known to 5 %"""
    time_limit_s: float = 420.0


@dataclass(frozen=True)
class Trial:
    """One drive of the campaign."""

    method: str
    seed: int

    @property
    def name(self) -> str:
        """Name of its result file."""
        return f"{self.method}-{self.seed:03d}"


@dataclass(frozen=True)
class Learnt:
    """Tyre parameters, their covariance, and loads held (over axle load): what a drive ended with, or begins with."""

    tyre: dict[str, float]
    covariance: list[list[float]]
    limits: tuple[float, float]


def true_tyre(seed: int, settings: CampaignSettings) -> dict[str, float]:
    """Tyre parameters of the car of a seed (C_x follows from its brakes and engine, which stay)."""
    lateral = {name: value for name, value in tyre_prior(load_car(), "per_axle").items() if name != "cx"}
    signs = np.random.default_rng([2024, seed]).choice([-1.0, 1.0], size=len(lateral))
    return {n: float(v * (1.0 + settings.mismatch * s)) for (n, v), s in zip(lateral.items(), signs, strict=True)}


def trial_config(trial: Trial, settings: CampaignSettings) -> Config:
    """Configuration of a trial: the seed's car, the trial's own sensor noise, the method's planner."""
    overrides: dict[str, Any] = {
        "track": settings.track,
        "plant.base": "paper",
        "declared_model": "paper",
        "plant.seed": 100 * trial.seed + (*METHODS, *AFTERWARDS, KNOWN).index(trial.method),
        **{f"plant.car.{name}": value for name, value in true_tyre(trial.seed, settings).items()},
    }
    config = load_config(None, overrides)
    if trial.method != "infomax":
        return config
    return exploring(
        config, information_weight=settings.information_weight, information_goal=settings.information_goal,
        information_criterion=settings.information_criterion,
    )  # fmt: skip


def run_trial(trial: Trial, settings: CampaignSettings, learnt: Learnt | None = None) -> dict[str, Any]:
    """Drive one trial; the result is plain data. `learnt` is what `learnt` drives with."""
    with TemporaryDirectory() as folder:
        config = trial_config(trial, settings)
        if trial.method not in METHODS:
            config = _without_learning(config, learnt or starting_knowledge(trial, settings), Path(folder))
        return _drive(trial, settings, config)


def job(trial: Trial, settings: CampaignSettings, learnt: Learnt | None = None) -> Job:
    """A trial as the runner takes it."""
    return Job(trial.name, asdict(settings), partial(run_trial, trial, settings, learnt))


def starting_knowledge(trial: Trial, settings: CampaignSettings) -> Learnt:
    """What `prior` and `known` drive with: declared or true tyres, how well they are known, and no load held."""
    tyre, share = dict(tyre_prior(load_car(), "per_axle")), settings.mismatch
    if trial.method == KNOWN:
        tyre, share = tyre | true_tyre(trial.seed, settings), KNOWN_STD
    covariance = np.diag([(share * value) ** 2 for value in tyre.values()])
    return Learnt(tyre, covariance.tolist(), (0.0, 0.0))


def _without_learning(config: Config, learnt: Learnt, folder: Path) -> Config:
    """Planner and estimator fixed on what is known, with its load limits."""
    model, limits = folder / "model.json", folder / "limits.json"
    covariance = tuple(map(tuple, learnt.covariance))
    revision = declared_revision(learnt.tyre).model_copy(update={"covariance": covariance})
    model.write_text(revision.model_dump_json())
    store_limits(limits, LoadLimits(*learnt.limits))
    return config.model_copy(update={
        "planner": config.planner.model_copy(update={"model": str(model), "load_limits": str(limits)}),
        "estimator": config.estimator.model_copy(update={"model": str(model), "learn": False}),
    })  # fmt: skip


def _drive(trial: Trial, settings: CampaignSettings, config: Config) -> dict[str, Any]:
    watch = Watch()

    def planner(config: Config, bus: Bus, track: Track) -> Planner:
        signal = ADDED_SIGNAL.get(trial.method)
        return Watched(config, ExcitedBus(bus, signal, trial.seed) if signal else bus, track, watch)

    loop = Loop(config, keep=(topics.BELIEF,), components={"estimator": RecordingEstimator, "planner": planner})
    seconds = settings.seconds if trial.method in METHODS else 0.0
    result = loop.run(laps=settings.laps, seconds=seconds or None, time_limit_s=settings.time_limit_s)
    estimator = loop.estimator
    assert isinstance(estimator, RecordingEstimator) and isinstance(loop.planner, Planner)
    tyre, judged = true_tyre(trial.seed, settings), loop.planner.adoption.controller.knowledge.load_max
    return {
        "trial": asdict(trial),
        "settings": asdict(settings),
        "truth": tyre,
        "safety": safety_figures(result, watch, estimator.kept, tyre, judged),
        "lap_times_s": result.lap_times_s,
        "start_s": loop.elapsed_s - result.seconds,
        "progress": _progress(watch, loop.elapsed_s - result.seconds),
        "belief": _beliefs(result),
        "held_out": _held_out(estimator.kept) if trial.method == KNOWN else None,
        "learnt": _learnt(result, loop.planner),
    }


def _progress(watch: Watch, start_s: float) -> dict[str, list[float]]:
    """Where the car was along the race line, m, once a second: seconds since it was armed."""
    t, s = np.array(watch.progress)[::PROGRESS_EVERY].T
    return {"t": np.round(t - START_NS / NS_PER_S - start_s, 3).tolist(), "s": np.round(s, 2).tolist()}


def _learnt(result: LoopResult, planner: Planner) -> dict[str, Any]:
    last = result.messages[topics.BELIEF.key][-1]
    assert isinstance(last, Belief)
    tyre = dict(zip(last.names, last.mean, strict=True))
    return asdict(Learnt(tyre, [list(row) for row in last.covariance], planner.next_limits().pair))


def _beliefs(result: LoopResult) -> dict[str, Any]:
    """Belief over time: seconds since the start of virtual time, D-criterion, mean."""
    messages = [m for m in result.messages[topics.BELIEF.key] if isinstance(m, Belief)]
    return {
        "t": [(m.stamp_ns - START_NS) / NS_PER_S for m in messages],
        "samples": [m.samples for m in messages],
        "log_det": [m.log_det_information for m in messages],
        "names": list(messages[-1].names),
        "mean": [list(m.mean) for m in messages],
        "std": [[float(np.sqrt(m.covariance[i][i])) for i in range(len(m.mean))] for m in messages],
    }


def _held_out(kept: list[Sample]) -> dict[str, Any]:
    """Samples at speed: slower, slip angles are noise."""
    samples = [sample for sample in kept if sample.signals[0] > SLIP_SPEED]
    return {
        "signals": [np.round(s.signals, 6).tolist() for s in samples],
        "z": [np.round(s.z, 5).tolist() for s in samples],
    }
