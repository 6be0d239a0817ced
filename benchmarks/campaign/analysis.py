"""What the trials of a learning campaign come to: samples to a target, lap time, safety, with intervals over seeds.

Targets, per car:

- D-criterion: the geometric mean over all directions in parameter space of standard deviation over prior standard
  deviation, det(P)^(1/2n), is so small that the tyres are known to 10, 5 or 3 %;
- held-out RMSE: lateral acceleration within a tenth of the true tyres' RMSE, on a lap at the limits of the true tyres
  that no way of driving has learnt from (`trial.KNOWN`);
- learnt: both at once, known to 5 % and RMSE.

A drive that never gets there counts with its whole length and is said to be censored. Ratios are paired by seed;
intervals are 95 % bootstrap percentiles over seeds (Efron & Tibshirani 1993).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.campaign.trial import METHODS
from estimator.model.measurement import CHANNELS, measurement_function
from estimator.model.parameters import tyre_parameters, tyre_prior
from estimator.model.single_track import AUXILIARY, SingleTrack
from hil_gateway.car.car import load_car
from hil_gateway.process.arrays import Array

RATE_HZ = 100.0
LATERAL = CHANNELS["imu_yaw"].index("imu_ay")
RMSE_MARGIN = 0.10
"""a belief is as good as it need be when its held-out RMSE is this share above that of the true tyres"""
ACCURACIES = {"d_10_percent": 0.10, "d_5_percent": 0.05, "d_3_percent": 0.03}
TARGETS = {
    **{name: f"D-criterion: tyre parameters known to {a:.0%} in the geometric mean" for name, a in ACCURACIES.items()},
    "rmse": f"held-out RMSE of ay within {RMSE_MARGIN:.0%} of the true tyres'",
    "learnt": f"both: known to 5 % and held-out RMSE within {RMSE_MARGIN:.0%}",
}
HEADLINE = "learnt"
BOTH = ("d_5_percent", "rmse")
"""what `learnt` asks for"""
BOOTSTRAP = 4000
SCORE_EVERY = 5
"""beliefs are scored twice a second"""


@dataclass(frozen=True)
class Drive:
    """One trial as the analysis sees it: times are driven seconds since the car was armed."""

    method: str
    seed: int
    t: Array
    log_det: Array
    mean: Array
    rmse_t: Array
    rmse: Array
    floor: float
    lap_times_s: tuple[float, ...]
    progress: tuple[Array, Array]
    """seconds and place along the race line, m"""
    parameter_error: Array
    """|mean / truth - 1| of the tyre's lateral parameters at the end"""
    safety: dict[str, Any]

    @property
    def seconds(self) -> float:
        """Length of the drive."""
        return float(self.t[-1])


@dataclass(frozen=True)
class Interval:
    """Median over seeds with its 95 % interval."""

    median: float
    low: float
    high: float


def drives_of(results: Sequence[dict[str, Any]]) -> list[Drive]:
    """Analysis view of all learning trials, scored on the lap at the limits of the same car."""
    score, held_out = _Score(), {r["trial"]["seed"]: r["held_out"] for r in results if r["held_out"] is not None}
    return [_drive(r, held_out[r["trial"]["seed"]], score) for r in results if r["trial"]["method"] in METHODS]


def _drive(result: dict[str, Any], held_out: dict[str, Any], score: _Score) -> Drive:
    belief, start = result["belief"], result["start_s"]
    t, mean = np.array(belief["t"]) - start, np.array(belief["mean"])
    moving = t >= 0.0
    t, mean = t[moving], mean[moving]
    truth = np.array([result["truth"].get(name, np.nan) for name in belief["names"]])
    signals, z = np.array(held_out["signals"]), np.array(held_out["z"])[:, LATERAL]
    true_theta = np.where(np.isnan(truth), mean[-1], truth)
    return Drive(
        method=result["trial"]["method"],
        seed=result["trial"]["seed"],
        t=t,
        log_det=np.array(belief["log_det"])[moving],
        mean=mean,
        rmse_t=t[::SCORE_EVERY],
        rmse=np.array([score(theta, signals, z) for theta in mean[::SCORE_EVERY]]),
        floor=score(true_theta, signals, z),
        lap_times_s=tuple(result["lap_times_s"]),
        progress=(np.array(result["progress"]["t"]), np.array(result["progress"]["s"])),
        parameter_error=np.abs(mean[-1] / truth - 1.0)[~np.isnan(truth)],
        safety=result["safety"],
    )


class _Score:
    """Held-out RMSE of the lateral acceleration, m/s2, all samples in one call."""

    def __init__(self) -> None:
        model = SingleTrack(load_car().vehicle, tyre_prior(load_car(), "per_axle"))
        self._h = measurement_function(model, "imu_yaw")
        assert len(tyre_parameters(tyre_prior(load_car(), "per_axle"))) == 7

    def __call__(self, theta: Array, signals: Array, z: Array) -> float:
        aux = np.zeros((len(AUXILIARY), 1))
        predicted = np.array(self._h(signals.T, aux, theta, np.zeros((0, 1)))[0])[LATERAL]
        return float(np.sqrt(np.mean((z - predicted) ** 2)))


def seconds_to(t: Array, values: Array, target: float, rising: bool) -> tuple[float, bool]:
    """First time from which `values` stay at or beyond `target`; the whole length and False where they do not."""
    beyond = values >= target if rising else values <= target
    if not beyond[-1]:
        return float(t[-1]), False
    last_miss = np.flatnonzero(~beyond)
    return float(t[0] if len(last_miss) == 0 else t[last_miss[-1] + 1]), True


def bootstrap(values: Sequence[float]) -> Interval:
    """Median and its 95 % bootstrap interval over seeds."""
    rng = np.random.default_rng(0)
    data = np.array(values)
    medians = np.median(rng.choice(data, (BOOTSTRAP, len(data))), axis=1)
    return Interval(float(np.median(data)), *(float(q) for q in np.percentile(medians, [2.5, 97.5])))


def d_target(accuracy: float) -> float:
    """log det of information at which parameters are known to `accuracy` in the geometric mean."""
    table = tyre_parameters(tyre_prior(load_car(), "per_axle"))
    return float(sum(2.0 * np.log(p.prior_std / p.prior / accuracy) for p in table))


def samples_to_targets(drives: Sequence[Drive]) -> dict[str, dict[str, dict[int, tuple[float, bool]]]]:
    """target -> method -> seed -> (samples, reached): samples are 100 Hz states driven."""
    table: dict[str, dict[str, dict[int, tuple[float, bool]]]] = {target: {} for target in TARGETS}
    for d in drives:
        for target, accuracy in ACCURACIES.items():
            found = seconds_to(d.t, d.log_det, d_target(accuracy), rising=True)
            table[target].setdefault(d.method, {})[d.seed] = (found[0] * RATE_HZ, found[1])
        found = seconds_to(d.rmse_t, d.rmse, (1.0 + RMSE_MARGIN) * d.floor, rising=False)
        table["rmse"].setdefault(d.method, {})[d.seed] = (found[0] * RATE_HZ, found[1])
        parts = [table[target][d.method][d.seed] for target in BOTH]
        table["learnt"].setdefault(d.method, {})[d.seed] = (max(n for n, _ in parts), all(ok for _, ok in parts))
    return table


def summarise(drives: Sequence[Drive], lap_length: float) -> dict[str, Any]:
    """The campaign in one JSON object; `lap_length` of the track in m."""
    samples = samples_to_targets(drives)
    methods = sorted({d.method for d in drives})
    return {
        "seeds": len({d.seed for d in drives}),
        "lap_length_m": lap_length,
        "methods": {method: _method(method, drives, samples, lap_length) for method in methods},
        "targets": TARGETS,
    }


def _method(method: str, drives: Sequence[Drive], samples: dict[str, Any], lap_length: float) -> dict[str, Any]:
    own = [d for d in drives if d.method == method]
    plain = {d.seed: d for d in drives if d.method == "plain"}
    laps = [d.lap_times_s for d in own]
    lost = [lap_time_lost_percent(d, plain[d.seed], lap_length) for d in own]
    targets = {}
    for target, by_method in samples.items():
        mine, theirs = by_method[method], by_method["plain"]
        ratios = [theirs[seed][0] / max(mine[seed][0], 1.0) for seed in mine]
        targets[target] = {
            "samples": vars(bootstrap([n for n, _ in mine.values()])),
            "laps": vars(bootstrap([_laps_of(d, mine[d.seed][0] / RATE_HZ, lap_length) for d in own])),
            "fewer_than_plain": vars(bootstrap(ratios)),
            "reached": sum(reached for _, reached in mine.values()),
        }
    return {
        "targets": targets,
        "lap_time_lost_percent": vars(bootstrap(lost)),
        "lap_times_s": [
            vars(bootstrap([lap[i] for lap in laps if len(lap) > i])) for i in range(max(map(len, laps), default=0))
        ],
        "parameter_error": vars(bootstrap([float(np.mean(d.parameter_error)) for d in own])),
        "rmse_at_end": vars(bootstrap([float(d.rmse[-1]) for d in own])),
        "rmse_floor": vars(bootstrap([d.floor for d in own])),
        "violations": {
            "track": sum(d.safety["off_track"] for d in own),
            "load": sum(d.safety["load_violations"] for d in own),
            "traction": sum(d.safety["traction_lost"] for d in own),
        },
        "load_by_model": sum(d.safety["load_by_model"] for d in own),
        "worst_load_share": max(d.safety["worst_load_share"] for d in own),
        "worst_true_load_share": max(d.safety["worst_true_load_share"] for d in own),
        "worst_margin_m": min(d.safety["worst_margin_m"] for d in own),
        "plan_failures": sum(d.safety["plan_failures"] for d in own),
        "failsafes": sum(len(d.safety["failsafes"]) for d in own),
    }


def lap_time_lost_percent(drive: Drive, reference: Drive, lap_length: float) -> float:
    """Time `drive` takes longer than `reference` over the distance both have driven, % of as many laps.

    Over less than a lap it is % of one lap at the pace of `reference`: what exploring costs the lap it ends in.
    """
    distance = min(float(d.progress[1][-1]) for d in (drive, reference))
    mine, theirs = (float(np.interp(distance, d.progress[1], d.progress[0])) for d in (drive, reference))
    return 100.0 * (mine / theirs - 1.0) * min(1.0, distance / lap_length)


def _laps_of(drive: Drive, seconds: float, lap_length: float) -> float:
    """Driven seconds as laps of the race line."""
    t, s = drive.progress
    return float((np.interp(seconds, t, s) - s[0]) / lap_length)
