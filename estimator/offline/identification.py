"""The whole of an identification: health, smoothing, split, fit by the chosen method, scores, identifiability."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from estimator.drive_log.table import DriveLog
from estimator.model.columns import ModelColumns
from estimator.offline.fit.equation_error import EquationErrorFit
from estimator.offline.fit.identifiability import Identifiability, analyse
from estimator.offline.fit.recursive import Curve, Recursion
from estimator.offline.fit_and_repair import (
    FITTED,
    Formulation,
    Options,
    Progress,
    Task,
    fit_and_repair,
    formulation_of,
)
from estimator.offline.health import HealthReport
from estimator.offline.health.steering import without_lag
from estimator.offline.known_bank import examine_on_its_road
from estimator.offline.predict.rollout import Rollout
from estimator.offline.record.prepare import Samples, prepare, spinning
from estimator.offline.result.identification_score import (
    LogScore,
    Scores,
    as_summary,
    score_at_states,
    score_samples,
    simulations,
)
from estimator.offline.split import Split
from hil_gateway.car.vehicle import Vehicle

__all__ = ["Identification", "Options", "Progress", "identify", "score_log"]


@dataclass(frozen=True)
class Identification:
    """Everything a report needs.

    `initial` and `final` are tyre parameters; `rmse` is channel -> (initial, final) on held-out data, simulated where
    the formulation simulates, `rmse_at_states` the same at the measured states; `rollouts` are (initial, final)
    open-loop predictions of the held-out data, `samples` are those of the whole log; `recursion` is what the batches
    (or samples) one by one make of it, also where all samples were fitted at once.
    """

    options: Options
    vehicle: Vehicle
    formulation: Formulation
    log: DriveLog
    samples: Samples
    split: Split
    health: HealthReport
    columns: ModelColumns
    fit: EquationErrorFit
    initial: Mapping[str, float]
    rmse: Scores
    rmse_at_states: Scores
    recursion: Recursion
    identifiability: Identifiability
    rollouts: tuple[Rollout, Rollout]
    seconds: float
    notes: tuple[str, ...] = field(default=())

    @property
    def final(self) -> dict[str, float]:
        """Tyre parameters identified."""
        return {n: self.fit.values[n] for n in self.initial}

    def summary(self) -> dict[str, Any]:
        """The `--json` object."""
        known = self.identifiability
        return {
            "layout": self.options.layout,
            "method": self.options.method,
            "formulation": self.formulation,
            "initial": dict(self.initial),
            "final": self.final,
            "std": {n: self.fit.std[n] for n in self.initial},
            "covariance": {"names": list(self.fit.names), "matrix": self.fit.covariance.tolist()},
            "identifiable": known.identifiable,
            "not_determined": list(known.statements),
            "information": {
                "trace": known.trace,
                "d_criterion": _finite(known.d_criterion),
                "a_criterion": _finite(known.a_criterion),
                "e_criterion": known.e_criterion,
                "condition_number": _finite(known.condition_number),
            },
            "nuisance": {n: {"value": v, "std": self.fit.std[n]} for n, v in self.fit.values.items() if "." in n},
            "rmse": as_summary(self.rmse),
            "rmse_at_states": as_summary(self.rmse_at_states),
            "curve": _points(self.recursion.curve),
            "curve_as_published": _points(self.recursion.as_published),
            "health": [finding.summary() for finding in self.health.findings],
            "rows": len(self.log),
            "samples": len(self.samples),
            "split": self.split.kind,
            "notes": [*self.log.notes, *self.notes],
            "seconds": self.seconds,
        }


def identify(
    log: DriveLog,
    vehicle: Vehicle,
    tyre_prior: Mapping[str, float],
    options: Options,
    progress: Progress = lambda what, share: None,
) -> Identification:
    """Identify the tyre parameters of `vehicle` from `log`."""
    began = time.perf_counter()
    progress("log health", 0.0)
    health = examine_on_its_road(log, vehicle, options.keep)
    task = Task(health.log, vehicle, tyre_prior, options, formulation_of(options, health.log), progress)
    fitted, task, health = fit_and_repair(task, health)
    progress("held-out error", FITTED)
    held_out = fitted.samples.select(fitted.split.test)
    columns, theta = fitted.columns, fitted.fit.theta
    rollouts = simulations(columns, theta, task.log, held_out, options.window_s)
    scores = score_samples(columns, theta, held_out, rollouts if task.formulation == "output_error" else None)
    train = fitted.samples.select(fitted.split.train)
    known = analyse(fitted.fit, train, vehicle, options.layout, health.vy_may_be_off)
    return Identification(
        options=options,
        vehicle=vehicle,
        formulation=task.formulation,
        log=task.log,
        samples=fitted.samples,
        split=fitted.split,
        health=health,
        columns=fitted.columns,
        fit=fitted.fit,
        initial={p.name: p.prior for p in fitted.columns.model.tyre_table},
        rmse=scores,
        rmse_at_states=score_at_states(columns, theta, held_out),
        recursion=fitted.recursion,
        identifiability=known,
        rollouts=rollouts,
        notes=_notes(task.log),
        seconds=time.perf_counter() - began,
    )


def score_log(result: Identification, log: DriveLog) -> LogScore:
    """Scores of the whole of another `log`, repaired by its own log health and by the steering lag of `result`."""
    options = result.options
    repaired = without_lag(examine_on_its_road(log, result.vehicle, options.keep).log, result.health.findings)
    columns, theta, samples = result.columns, result.fit.theta, prepare(repaired)
    rollouts = simulations(columns, theta, repaired, samples, options.window_s)
    return LogScore(
        score_samples(columns, theta, samples, rollouts if result.formulation == "output_error" else None),
        score_at_states(columns, theta, samples),
    )


def _points(curve: Curve) -> list[dict[str, float]]:
    return [{"batch": p.batch, **p.rmse} for p in curve]


def _notes(log: DriveLog) -> tuple[str, ...]:
    spun = int(spinning(log).sum())
    return (f"{spun} rows are left out: the car spins or slides sideways",) if spun else ()


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None
