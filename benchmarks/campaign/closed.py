"""The closed loop without a person: drive with the declared model, diagnose the drive, drive on with what was found.

One process and a virtual clock, so that a case is minutes instead of a quarter of an hour. The second drive has
other sensor noise; neither the declared nor the diagnosed model has seen it.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from estimator.belief.revision import declared_revision
from estimator.drive_log.table import DriveLog
from estimator.model.parameters import tyre_prior
from estimator.offline.diagnosis import diagnose
from estimator.offline.record.record import make_record
from estimator.offline.report.diagnosis_result import as_json, as_revision
from estimator.offline.result.model_score import score_revisions
from hil_gateway.car.car import load_car
from hil_gateway.config import Config, load_config
from hil_gateway.process.figures import figure
from planner.simulation.loop import Loop, LoopResult
from planner.simulation.loop_log import LOGGED, drive_log

SLOWEST_LAP_S = 250.0
CHANNEL = "position"
"""what stands for the prediction error: m after one second of open-loop prediction"""
HALF = 0.5


@dataclass(frozen=True)
class Drive:
    """What one drive came to."""

    lap_times_s: list[float]
    off_track: int
    worst_margin_m: float
    plan_failures: int


@dataclass(frozen=True)
class Closed:
    """One closed loop: `found` are the named effects, `error` the prediction errors of both models, m."""

    effects: Mapping[str, float]
    found: list[str]
    verdict: str
    error: dict[str, float]
    before: Drive
    after: Drive
    parameters: dict[str, dict[str, Any]] = field(default_factory=dict)

    @property
    def kept(self) -> bool:
        """Error at most half, lap no slower, nothing off the track."""
        return (
            self.error["after"] <= HALF * self.error["before"]
            and min(self.after.lap_times_s, default=float("inf")) <= min(self.before.lap_times_s, default=0.0)
            and self.before.off_track == self.after.off_track == 0
        )

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        return {**asdict(self), "kept": self.kept}


def close_loop(effects: Mapping[str, float], base: str, laps: int, seed: int, track: str = "") -> Closed:
    """Drive, diagnose, drive again; `base` is the simulated car ("av24" or "paper") the effects are added to;
    `track` is a file or a name, the road course where empty."""
    car = {"track": track, "plant.base": base, "plant.effects": dict(effects), "plant.seed": seed}
    overrides: dict[str, Any] = {**car, "declared_model": "paper"}  # what that lacks is to be found
    config = load_config(None, overrides)
    first, log = _drive(config, laps)
    layout = config.estimator.layout
    diagnosis = diagnose(make_record(log, config.vehicle), layout, tyre_prior(load_car(), layout))
    revision, found = as_revision(diagnosis, layout, ("driven by the loop",)), as_json(diagnosis, "", "")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.json"
        path.write_text(revision.model_dump_json())
        model = {"planner.model": str(path), "estimator.model": str(path), "plant.seed": seed + 1}
        second, again = _drive(load_config(None, overrides | model), laps)
    score = score_revisions(again.columns, declared_revision(tyre_prior(load_car(), layout)), revision, config)
    return Closed(
        effects=dict(effects),
        found=[effect["name"] for effect in found["effects"]],
        verdict=found["verdict"],
        error={when: score[when][CHANNEL] for when in ("before", "after")},
        before=first,
        after=second,
        parameters={effect["name"]: effect["parameters"] for effect in found["effects"]},
    )


def _drive(config: Config, laps: int) -> tuple[Drive, DriveLog]:
    result: LoopResult = Loop(config, keep=LOGGED).run(laps=laps, time_limit_s=laps * SLOWEST_LAP_S)
    summary = Drive(result.lap_times_s, result.off_track, result.worst_margin_m, result.plan_failures)
    return summary, drive_log(result)


def describe(case: Closed) -> str:
    """One case in one line."""
    effect = ", ".join(f"{name}={size:g}" for name, size in case.effects.items())
    laps = [min(drive.lap_times_s, default=None) for drive in (case.before, case.after)]
    return (
        f"{effect}: {case.verdict} ({', '.join(case.found) or 'nothing named'}); error after 1 s "
        f"{figure(case.error['before'], digits=3)} -> {figure(case.error['after'], 'm', 3)}, "
        f"best lap {figure(laps[0])} -> {figure(laps[1], 's')}, "
        f"off track {case.before.off_track} -> {case.after.off_track}: {'kept' if case.kept else 'NOT kept'}"
    )
