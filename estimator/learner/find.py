"""What the laps so far say that the model in force lacks: search, two models as they would be driven, their scores.

The last lap is held out. Both models, re-fitted with and without new effects, are handed over in the same way (a
tempered fit around what is declared) and scored as the planner would use them. A pure function: the process that runs
it may be anywhere.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from estimator.belief.revision import model_of, revision_id
from estimator.drive_log.table import DriveLog, segment_numbers
from estimator.learner.active import active_effects, parameter_std
from estimator.learner.known_road import ROAD, on_map, road_effects, road_size, with_map_road, with_road
from estimator.learner.rule import Errors, why_not
from estimator.model.declared_vehicle import DECLARED
from estimator.model.effects import catalogue
from estimator.model.effects.base import Effect
from estimator.offline.diagnosis import HELD_OUT_WINDOWS
from estimator.offline.fit.prediction_error import Fit
from estimator.offline.record.record import Record, make_record
from estimator.offline.record.road import find_road
from estimator.offline.result.handover import tempered
from estimator.offline.result.model_score import held_out_windows, prediction_error, track_positions
from estimator.offline.search.search import search
from estimator.offline.search.trial import Setting
from hil_gateway.bus.messages import ActiveEffect, ModelRevision, Provenance
from hil_gateway.config import Config
from hil_gateway.process.arrays import Array
from hil_gateway.track.loading import load_track
from hil_gateway.track.track import Track

UNTRIED = frozenset({*DECLARED, "imu_bias", "grip_drift", "brake_pressure", "total_slip"})
"""what a running loop cannot have: vehicle data, which are declared; what the state filter estimates itself; what needs
the time since the start of the log or the brakes' pressure, which no plan knows"""
LEAST_LAPS = 3
"""two to learn from and one to be judged by"""


@dataclass(frozen=True)
class Task:
    """Laps to learn from, and the models of the run.

    Attributes:
        columns: name -> (n,) drive-log columns, the last `lap` held out.
        declared: the model the run began with, how well it is known.
        current: the model driven with now.
    """

    columns: Mapping[str, Array]
    declared: ModelRevision
    current: ModelRevision
    config: Config


@dataclass(frozen=True)
class FirstLap:
    """A lap driven with a model that was adopted: its number in the columns of `task`, and the model before."""

    task: Task
    lap: int
    before: ModelRevision


@dataclass(frozen=True)
class Found:
    """Outcome: effects that are new, the model to drive with and why it is not to be, errors on the held-out lap."""

    effects: tuple[str, ...]
    revision: ModelRevision
    reason: str
    errors: Mapping[str, Errors]


def find(task: Task) -> Found:
    """Diagnose the laps of `task`.

    Raises:
        InputError: too little driving in them.
    """
    track = load_track(task.config.track)
    mapped = task.config.declared_model == "race_car"
    held_out = int(task.columns["lap"].max())
    record = _record(task, track, mapped)
    train = record.select(record.lap < int(record.lap.max()))
    if not mapped:
        train = replace(train, road=find_road(train))
    train = replace(train, lap=np.arange(train.windows, dtype=np.int64) // HELD_OUT_WINDOWS)
    done = search(_setting(task, train, mapped))
    size = road_size(track) if mapped else 0
    models = {
        "in_force": task.current,
        "refit": _revision(done.start, task, train, mapped),
        "found": _revision(done.final, task, train, mapped),
    }
    errors = {name: score(m, task, track, held_out, size) for name, m in models.items()}
    known = {effect.name for effect in task.current.effects}
    effects = tuple(e.name for e in models["found"].effects if e.name not in known)
    reason = why_not(errors["refit"], errors["in_force"], errors["found"]) if effects else NOTHING
    return Found(effects, _with_provenance(models["found"], effects, errors, held_out), reason, errors)


def judge(first: FirstLap) -> tuple[Errors, Errors]:
    """Errors of the model before and of the current one on the first whole lap driven with the latter.

    Raises:
        InputError: too little driving in it.
    """
    task, track = first.task, load_track(first.task.config.track)
    mapped = task.config.declared_model == "race_car"
    size = road_size(track) if mapped else 0
    return score(first.before, task, track, first.lap, size), score(task.current, task, track, first.lap, size)


NOTHING = "no effect of the catalogue explains more of the laps so far"


def _record(task: Task, track: Track, mapped: bool) -> Record:
    columns = task.columns
    log = DriveLog(columns=columns, segment=segment_numbers(columns["t"]))
    record = make_record(log, task.config.vehicle)
    if not mapped:
        return record
    return with_map_road(on_map(record, track, track_positions(columns, track)), track)


def _setting(task: Task, train: Record, mapped: bool) -> Setting:
    declared, names = task.declared, {effect.name for effect in task.declared.effects}
    adopted = [effect for effect in task.current.effects if effect.name not in names]
    active = (*active_effects(declared, adopted), *(road_effects() if mapped else ()))
    std = {name: value for name, value in parameter_std(declared).items() if name in declared.tyre}
    layout = task.config.estimator.layout
    return Setting(train, layout, dict(declared.tyre), active=active, tyre_std=std or None, untried=UNTRIED)


def _revision(fit: Fit, task: Task, train: Record, mapped: bool) -> ModelRevision:
    """A fit as estimator and planner take it over: tyres and effects with their common covariance."""
    told = tempered(fit.predictor.model, fit.parameters, train, fit.deviation)
    tyres = len(fit.predictor.model.tyre_table)
    tyre = {p.name: float(v) for p, v in zip(fit.predictor.model.tyre_table, told.parameters, strict=False)}
    left_out = {*ROAD} if mapped else set[str]()
    blocks = [b for b in told.predictor.blocks if b.effect.name in catalogue() and b.effect.name not in left_out]
    effects = tuple(_active(b.effect, told.parameters[b.parameters]) for b in blocks)
    rows = [*range(tyres), *(i for b in blocks for i in range(b.parameters.start, b.parameters.stop))]
    if any(effect.profile for effect in effects):
        rows = rows[:tyres]  # a profile is not learnt while driving, nor are effects beside it
    covariance = told.covariance[np.ix_(rows, rows)]
    return ModelRevision(
        stamp_ns=0, seq=0, revision=revision_id(task.declared.layout, tyre, effects), layout=task.declared.layout,
        tyre=tyre, effects=effects, covariance=tuple(map(tuple, (0.5 * (covariance + covariance.T)).tolist())),
    )  # fmt: skip


def _active(effect: Effect, values: Array) -> ActiveEffect:
    """An effect with the parameters found: named values, or the coefficients of its profile."""
    numbers = values.tolist()
    if effect.profile:
        return ActiveEffect(name=effect.name, parameters={}, profile=tuple(numbers))
    return ActiveEffect(
        name=effect.name, parameters={p.name: v for p, v in zip(effect.parameters, numbers, strict=True)}
    )


def score(revision: ModelRevision, task: Task, track: Track, lap: int, road_size: int) -> Errors:
    """RMS errors of a model after one second of open-loop prediction on one lap of the task.

    Args:
        road_size: coefficients of the map's road over the lap, which predictions go with; 0: a level road.
    """
    on_lap = task.columns["lap"] == lap
    columns = {name: column[on_lap] for name, column in task.columns.items()}
    whole = with_road(revision, track, road_size) if road_size else revision
    windows = held_out_windows(columns, float(columns["t"][0]), track)
    return prediction_error(model_of(whole, task.config.vehicle, track.length), windows)


def _with_provenance(
    revision: ModelRevision, effects: tuple[str, ...], errors: Mapping[str, Errors], lap: int
) -> ModelRevision:
    note = f"{', '.join(effects)}: found while driving, judged on lap {lap + 1}" if effects else ""
    provenance = Provenance(error_before=dict(errors["refit"]), error_after=dict(errors["found"]), note=note)
    return revision.model_copy(update={"provenance": provenance})
