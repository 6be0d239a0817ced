"""What the laps so far say that the model in force lacks: search, two models as they would be driven, their scores.

The last lap is held out. Both models, re-fitted with and without new effects, are learnt from the other laps in the
same way (`learnt_model`) and scored as the planner would use them; an effect that spoils the prediction is left out.
A pure function: the process that runs it may be anywhere.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from estimator.belief.revision import model_of
from estimator.drive_log.derived import BY_STATE_FILTER
from estimator.drive_log.table import DriveLog, segment_numbers
from estimator.learner.active import active_effects, parameter_std
from estimator.learner.learnt_model import SPREAD, LapColumns, learnt_model, parameters_of
from estimator.learner.rule import IDLE, Errors, mean_ratio, why_not
from estimator.model.declared_vehicle import DECLARED
from estimator.model.effects import catalogue
from estimator.model.look_alikes import LOOK_ALIKES
from estimator.offline.diagnosis import held_out_in_turn
from estimator.offline.fit.prediction_error import Fit
from estimator.offline.record.map_road import (
    ROAD,
    on_map,
    projected,
    road_effects,
    road_profiles,
    road_size,
    with_map_road,
)
from estimator.offline.record.record import Record, make_record
from estimator.offline.record.road import find_road
from estimator.offline.result.model_score import held_out_windows, prediction_error
from estimator.offline.search.search import search
from estimator.offline.search.trial import Setting
from hil_gateway.bus.messages import ActiveEffect, ModelRevision, Provenance
from hil_gateway.config import Config
from hil_gateway.process.arrays import Array
from hil_gateway.process.errors import InputError
from hil_gateway.track.loading import load_track
from hil_gateway.track.track import Track

LEAST_LAPS = 3
"""two to learn from and one to be judged by"""
LEAST_S = 15.0
"""of the held-out lap with estimates: bends, straights and braking of a short oval"""


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
    ground = Ground.of(task)
    held_out = int(task.columns["lap"].max())
    _check_lap(task, held_out)
    record = _record(task, ground)
    train = record.select(record.lap < int(record.lap.max()))
    if not ground.mapped:
        train = replace(train, road=find_road(train))
    train = replace(train, lap=held_out_in_turn(train.windows))
    done = search(_setting(task, train, ground), thorough=False)
    before = {"in_force": task.current, "refit": _taught(_effects(done.start, ground), task, ground)}
    rivals = {name: score(model, task, ground, held_out) for name, model in before.items()}
    final = _effects(done.final, ground)
    known = {effect.name for effect in (*task.declared.effects, *task.current.effects)}

    def outcome(effects: tuple[str, ...]) -> Found:
        """The model with these of the new effects."""
        model = _taught([e for e in final if e.name in known or e.name in effects], task, ground)
        errors = {**rivals, "found": score(model, task, ground, held_out)}
        reason = why_not(errors["refit"], errors["in_force"], errors["found"]) if effects else NOTHING
        return Found(effects, _with_provenance(model, effects, errors, held_out), reason, errors)

    whole = without_what_spoils(outcome(tuple(e.name for e in final if e.name not in known)), outcome)
    return without_what_is_idle(whole, outcome)


def without_what_spoils(whole: Found, outcome: Callable[[tuple[str, ...]], Found]) -> Found:
    """`whole`, or where it is not to be driven with, what is left of it after taking effects away one by one, each
    time the one without which predictions are best.

    A fit shares what it explains among its effects, and the belief that goes on while driving holds some of them at
    other sizes: one that spoils a channel does not take the others with it.
    """
    left = whole
    while left.reason and len(left.effects) > 1:
        left = min(_one_less(left, outcome), key=lambda f: (bool(f.reason), _ratio(f)))
    return whole if left.reason else left


def without_what_is_idle(whole: Found, outcome: Callable[[tuple[str, ...]], Found]) -> Found:
    """`whole` without effects that predict nothing: those without which it may be driven with and predicts as well.

    A fit spends small effects of the sensors on what is left of the model's errors, and they change what the belief
    makes of the others.
    """
    left = whole
    while not left.reason and len(left.effects) > 1:
        fewer = min(_one_less(left, outcome), key=lambda f: (bool(f.reason), _ratio(f)))
        if fewer.reason or _ratio(fewer) > IDLE * _ratio(left):
            break
        left = fewer
    return left


def _one_less(found: Found, outcome: Callable[[tuple[str, ...]], Found]) -> list[Found]:
    return [outcome(tuple(n for n in found.effects if n != name)) for name in found.effects]


def _ratio(found: Found) -> float:
    return mean_ratio(found.errors["refit"], found.errors["found"])


def judge(first: FirstLap) -> tuple[Errors, Errors]:
    """Errors of the model before and of the current one on the first whole lap driven with the latter.

    Raises:
        InputError: too little driving in it.
    """
    task, ground = first.task, Ground.of(first.task)
    _check_lap(task, first.lap)
    return score(first.before, task, ground, first.lap), score(task.current, task, ground, first.lap)


@dataclass(frozen=True)
class Ground:
    """The track; where its slopes and bank are declared (`mapped`) they are no finding. `position` (n,) of every row,
    m of arc length."""

    track: Track
    mapped: bool
    position: Array

    @classmethod
    def of(cls, task: Task) -> Ground:
        """Of the laps of a task."""
        track = load_track(task.config.track)
        return cls(track, task.config.declared_model == "race_car", projected(task.columns, track)[0])


NOTHING = "no effect of the catalogue explains more of the laps so far"


def _check_lap(task: Task, lap: int) -> None:
    """Raises an `InputError` for a lap with too few valid estimates to be judged by."""
    step = float(np.median(np.diff(task.columns["t"])))
    covered_s = step * np.count_nonzero(task.columns["lap"] == lap)
    if covered_s < LEAST_S:
        raise InputError(f"only {covered_s:.0f} s of estimates in the held-out lap: at least {LEAST_S:g} s are needed")


def _record(task: Task, ground: Ground) -> Record:
    columns = {name: column for name, column in task.columns.items() if name not in SPREAD}
    log = DriveLog(columns=columns, segment=segment_numbers(columns["t"]), derived=BY_STATE_FILTER)
    record = make_record(log, task.config.vehicle)
    return with_map_road(on_map(record, ground.track, ground.position), ground.track) if ground.mapped else record


def _setting(task: Task, train: Record, ground: Ground) -> Setting:
    declared, names = task.declared, {effect.name for effect in task.declared.effects}
    adopted = [effect for effect in task.current.effects if effect.name not in names]
    active = (*active_effects(declared, adopted), *(road_effects() if ground.mapped else ()))
    std = {name: value for name, value in parameter_std(declared).items() if name in declared.tyre}
    layout = task.config.estimator.layout
    return Setting(train, layout, dict(declared.tyre), active=active, tyre_std=std or None, untried=_unsought())


def _unsought() -> frozenset[str]:
    """What a running loop does not look for: vehicle data, which are declared, what only resembles an effect, and what
    the catalogue says so of."""
    return frozenset({*DECLARED, *LOOK_ALIKES, *(n for n, e in catalogue().items() if e.unsought_while_driving)})


def _effects(fit: Fit, ground: Ground) -> list[ActiveEffect]:
    """Effects of a fit that a model to drive with may have, with their values."""
    left_out = {*ROAD} if ground.mapped else set[str]()
    known = {name for name, effect in catalogue().items() if effect.moves_the_car}
    blocks = [b for b in fit.predictor.blocks if b.effect.name in known - left_out]
    return [parameters_of(b.effect.name, fit.parameters[b.parameters]) for b in blocks]


def _taught(effects: list[ActiveEffect], task: Task, ground: Ground) -> ModelRevision:
    """The model with these effects, learnt from all laps but the last."""
    known = {effect.name for effect in task.declared.effects}
    learnt = task.columns["lap"] < task.columns["lap"].max()
    columns = {name: column[learnt] for name, column in task.columns.items()}
    further = [effect for effect in effects if effect.name not in known]
    return learnt_model(task.declared, further, LapColumns(columns, ground.position[learnt]), task.config, ground.track)


def score(revision: ModelRevision, task: Task, ground: Ground, lap: int) -> Errors:
    """RMS errors of a model after one second of open-loop prediction on one lap of the task."""
    on_lap = task.columns["lap"] == lap
    columns = {name: column[on_lap] for name, column in task.columns.items()}
    whole = with_road(revision, ground.track) if ground.mapped else revision
    windows = held_out_windows(columns, float(columns["t"][0]), ground.track)
    return prediction_error(model_of(whole, task.config.vehicle, ground.track.length), windows)


def _with_provenance(
    revision: ModelRevision, effects: tuple[str, ...], errors: Mapping[str, Errors], lap: int
) -> ModelRevision:
    note = f"{', '.join(effects)}: found while driving, judged on lap {lap + 1}" if effects else ""
    provenance = Provenance(error_before=dict(errors["refit"]), error_after=dict(errors["found"]), note=note)
    return revision.model_copy(update={"provenance": provenance})


def with_road(revision: ModelRevision, track: Track) -> ModelRevision:
    """A revision that also has the map's road, as the planner adds it: for predictions only."""
    road = (
        ActiveEffect(name=name, parameters={}, profile=tuple(values.tolist()))
        for name, values in road_profiles(track, road_size(track)).items()
    )
    return revision.model_copy(update={"effects": (*revision.effects, *road)})
