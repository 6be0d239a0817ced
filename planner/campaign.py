"""Learning campaign: how many samples until the tyres are known, driving to learn against driving normally.

A trial is one seed and one way of driving, closed loop on the simulated car in one process on virtual time. Each seed
is another car: every tyre parameter is drawn around the declared one. All ways of driving meet the same cars:

- `infomax`: Eq. (9) with the information term and a small pseudo-random dither on the steering: at zero slip the
  information has a saddle, its gradient vanishes, and on a straight nothing else would leave it;
- `plain`: the same planner with q_I = 0;
- `prbs`, `sine`: the plain planner with a pseudo-random binary or a swept-sine signal of the same size added.

All keep the same track, load and actuator limits; the size is the largest that kept them on every car tried.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from estimator.model.parameters import DEFAULT_TYRE
from estimator.node import Estimator
from estimator.tyre_belief import Array, Sample
from hil_gateway import topics
from hil_gateway.bus import Bus
from hil_gateway.clock import NS_PER_S
from hil_gateway.config import Config, load_config
from hil_gateway.messages import Belief, Command
from hil_gateway.track import Track
from hil_gateway.vehicle import Vehicle
from planner.loop import START_NS, Loop, LoopResult
from planner.node import Planner
from planner.safety import LOAD_TOLERANCE, Watch, Watched

METHODS = ("infomax", "plain", "prbs", "sine")

EXCITATION_ACCELERATION = 1.5
"""lateral acceleration the added steering signals ask for, m/s2; 2.5 left 1 cm to the edge of the track"""
EXCITATION_MIN_SPEED = 15.0
EXCITATION_MAX = 0.02
"""rad"""
KEEP_EVERY = 10
"""one sample in so many is kept for held-out scoring"""
SLIP_SPEED = 10.0
"""m/s"""


@dataclass(frozen=True)
class CampaignSettings:
    """What is compared; two campaigns with equal settings give equal results."""

    laps: int = 1
    track: str = ""
    spread: tuple[float, float] = (0.85, 1.15)
    """range of the true B and C over the declared ones"""
    grip_spread: tuple[float, float] = (1.0, 1.25)
    """range of the true D over the declared one: Eq. (10) presumes that the tyres bear what F-bar says"""
    information_weight: float = 8.0
    information_criterion: str = "log_det"
    convexification: str = "projection"
    """IMU measurements do not separate over the axles: the exact Hessian, projected"""
    information_bound: float = 1000.0
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


def true_tyre(seed: int, settings: CampaignSettings) -> dict[str, float]:
    """Tyre parameters of the car of a seed (C_x follows from its brakes and engine, which stay)."""
    rng = np.random.default_rng([2024, seed])
    ranges = {"b": settings.spread, "c": settings.spread, "d": settings.grip_spread}
    lateral = {name: value for name, value in DEFAULT_TYRE["per_axle"].items() if name != "cx"}
    return {name: float(value * rng.uniform(*ranges[name[0]])) for name, value in lateral.items()}


def trial_config(trial: Trial, settings: CampaignSettings) -> Config:
    """Configuration of a trial: the seed's car, the trial's own sensor noise, the method's planner."""
    overrides: dict[str, Any] = {
        "track": settings.track,
        "plant.base": "paper",
        "plant.seed": 100 * trial.seed + METHODS.index(trial.method),
        **{f"plant.car.{name}": value for name, value in true_tyre(trial.seed, settings).items()},
    }
    if trial.method == "infomax":
        overrides["planner.information_weight"] = settings.information_weight
        overrides["planner.information_criterion"] = settings.information_criterion
        overrides["planner.convexification"] = settings.convexification
        overrides["planner.information_bound"] = settings.information_bound
    return load_config(None, overrides)


class ExcitedBus:
    """The planner's bus with a steering signal added to every command."""

    def __init__(self, bus: Bus, method: str, seed: int) -> None:
        self._bus, self._method = bus, method
        self._rng = np.random.default_rng([77, seed])
        self._state = bus.subscribe(topics.ESTIMATE)
        self._speed, self._sign, self._switch_ns = 0.0, 1.0, 0
        self.subscribe, self.close = bus.subscribe, bus.close

    def publish(self, topic: Any, message: Any) -> None:
        """Publish, commands with the signal of this moment."""
        if isinstance(message, Command):
            message = message.model_copy(update={"steer": message.steer + self._signal(message.stamp_ns)})
        self._bus.publish(topic, message)

    def _signal(self, now_ns: int) -> float:
        """Steering angle to add, rad: sized for one lateral acceleration at every speed."""
        for estimate in self._state.poll(now_ns):
            self._speed = estimate.vx
        if self._speed < EXCITATION_MIN_SPEED:
            return 0.0
        amplitude = min(EXCITATION_ACCELERATION * 3.0 / self._speed**2, EXCITATION_MAX)
        return amplitude * (self._prbs(now_ns) if self._method == "prbs" else self._sine(now_ns))

    def _prbs(self, now_ns: int) -> float:
        """+-1, held for 0.2 to 0.8 s."""
        if now_ns >= self._switch_ns:
            self._sign = -self._sign
            self._switch_ns = now_ns + int(self._rng.uniform(0.2, 0.8) * NS_PER_S)
        return self._sign

    def _sine(self, now_ns: int) -> float:
        """Sine sweeping from 0.3 to 1.2 Hz and back every 20 s."""
        t = now_ns / NS_PER_S
        return float(np.sin(2 * np.pi * (0.75 * t - 0.45 * 20.0 / (2 * np.pi) * np.cos(2 * np.pi * t / 20.0))))


class RecordingEstimator(Estimator):
    """Estimator that keeps some of the samples it learns from."""

    def __init__(self, config: Config, bus: Bus, track: Track | None = None) -> None:
        super().__init__(config, bus, track)
        self.kept: list[tuple[int, Sample]] = []
        self._seen = 0

    def learn(self, sample: Sample, stamp_ns: int) -> None:
        """See `Estimator.learn`."""
        self._seen += 1
        if self._seen % KEEP_EVERY == 0:
            self.kept.append((stamp_ns, sample))
        super().learn(sample, stamp_ns)


def run_trial(trial: Trial, settings: CampaignSettings) -> dict[str, Any]:
    """Drive one trial; the result is plain data, as `save` writes it."""
    config = trial_config(trial, settings)
    watch = Watch()

    def planner(config: Config, bus: Bus, track: Track) -> Planner:
        signal = None if trial.method == "plain" else "sine" if trial.method == "sine" else "prbs"
        return Watched(config, ExcitedBus(bus, signal, trial.seed) if signal else bus, track, watch)

    loop = Loop(config, keep=(topics.BELIEF,), components={"estimator": RecordingEstimator, "planner": planner})
    result = loop.run(laps=settings.laps, time_limit_s=settings.time_limit_s)
    estimator = loop.estimator
    assert isinstance(estimator, RecordingEstimator) and isinstance(loop.planner, Planner)
    tyre = true_tyre(trial.seed, settings)
    return {
        "trial": asdict(trial),
        "settings": asdict(settings),
        "truth": tyre,
        "safety": _safety(result, watch, estimator.kept, tyre, loop.planner.limits.pair),
        "lap_times_s": result.lap_times_s,
        "start_s": loop.elapsed_s - result.seconds,
        "belief": _beliefs(result),
        "kept": _kept(estimator.kept),
    }


def _safety(
    result: LoopResult, watch: Watch, kept: list[tuple[int, Sample]], tyre: Mapping[str, float],
    limits: tuple[float, float],
) -> dict[str, Any]:  # fmt: skip
    """Violations: off track by the referee, loads as `hil plan safety` counts them, traction by true tyres."""
    loads = np.maximum(watch.front, watch.rear)
    return {
        "laps": result.laps,
        "off_track": result.off_track,
        "worst_margin_m": result.worst_margin_m,
        "load_violations": int(np.sum(loads > 1.0 + LOAD_TOLERANCE)),
        "worst_load_share": float(loads.max(initial=0.0)),
        "worst_true_load_share": float(load_shares(kept, tyre, limits).max(initial=0.0)),
        "traction_lost": int(np.sum(slip_shares(kept, tyre) > 1.0)),
        "plan_failures": result.plan_failures,
        "failsafes": [list(entry) for entry in result.failsafes],
    }


def load_shares(kept: list[tuple[int, Sample]], tyre: Mapping[str, float], limits: tuple[float, float]) -> Array:
    """Force of either axle over its load limit at every kept sample, shape (2 K,) at most, with the true tyres.

    Written out in numpy so as not to judge the planner by its own model. `limits` are over static axle load. At
    walking speed a slip angle is mostly sensor noise: those samples are left out.
    """
    if not kept:
        return np.zeros(0)
    slip_f, slip_r, drive = _slips(kept)
    front = tyre["df"] * np.sin(tyre["cf"] * np.arctan(tyre["bf"] * slip_f))
    rear = tyre["dr"] * np.sin(tyre["cr"] * np.arctan(tyre["br"] * slip_r))
    along = DEFAULT_TYRE["per_axle"]["cx"] * drive / Vehicle().static_load_rear
    return np.concatenate([np.abs(front) / limits[0], np.hypot(rear, along) / limits[1]])


def slip_shares(kept: list[tuple[int, Sample]], tyre: Mapping[str, float]) -> Array:
    """Slip angle of either axle over that of the true tyre's peak, shape (2 K,) at most: above 1 traction is lost."""
    if not kept:
        return np.zeros(0)
    slip_f, slip_r, _ = _slips(kept)
    return np.concatenate([
        np.abs(slip) * tyre[b] / np.tan(0.5 * np.pi / max(tyre[c], 1.0 + 1e-6))
        for slip, b, c in ((slip_f, "bf", "cf"), (slip_r, "br", "cr"))
    ])  # fmt: skip


def _slips(kept: list[tuple[int, Sample]]) -> tuple[Array, Array, Array]:
    """Slip angles, rad, and drive command of the samples above `SLIP_SPEED`."""
    v = Vehicle()
    signals = np.array([sample.signals for _, sample in kept])
    vx, vy, rate, steer, drive = signals[signals[:, 0] > SLIP_SPEED].T
    return steer - np.arctan2(vy + v.lf * rate, vx), -np.arctan2(vy - v.lr * rate, vx), drive


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


def _kept(kept: list[tuple[int, Sample]]) -> dict[str, Any]:
    return {
        "t": [(stamp_ns - START_NS) / NS_PER_S for stamp_ns, _ in kept],
        "signals": [np.round(s.signals, 6).tolist() for _, s in kept],
        "z": [np.round(s.z, 5).tolist() for _, s in kept],
    }


def save(folder: Path, result: dict[str, Any]) -> None:
    """Write a trial's result beside the others; appears whole or not at all."""
    trial = Trial(**result["trial"])
    folder.mkdir(parents=True, exist_ok=True)
    temporary = folder / f".{trial.name}.tmp"
    temporary.write_text(json.dumps(result))
    temporary.replace(folder / f"{trial.name}.json")


def load(folder: Path, trial: Trial, settings: CampaignSettings) -> dict[str, Any] | None:
    """A trial done before with the same settings, or None."""
    try:
        result = json.loads((folder / f"{trial.name}.json").read_text())
    except (OSError, ValueError):
        return None
    same: bool = result.get("settings") == json.loads(json.dumps(asdict(settings)))
    return result if same else None
