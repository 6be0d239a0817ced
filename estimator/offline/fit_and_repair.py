"""A fit by the chosen method, and what it finds wrong with its log repaired: the log fitted again until it fits."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import reduce
from typing import Literal

import numpy as np

from estimator.drive_log.table import DriveLog
from estimator.model.columns import ModelColumns
from estimator.model.effect import Effect
from estimator.model.parameters import Layout
from estimator.model.single_track import SingleTrack
from estimator.offline.fit.equation_error import EquationErrorFit, fit
from estimator.offline.fit.output_error import OutputErrorSettings, fit_output_error
from estimator.offline.fit.recursive import Recursion, averaged, batch, sample
from estimator.offline.health import HealthReport
from estimator.offline.health.finding import LogFinding
from estimator.offline.health.lateral_velocity import place_left
from estimator.offline.health.log_corrections import moves_ay, without
from estimator.offline.health.offsets import lag_left
from estimator.offline.health.steering import LAG_STEER, lag_of, zero_of
from estimator.offline.known_bank import on_one_bandwidth
from estimator.offline.predict.fast_car import forces, loads, presses
from estimator.offline.predict.nuisance import (
    KNOWN_BANK,
    known_bank,
    steer_timing,
    steer_zero,
    vy_sensor,
    yaw_rate_timing,
)
from estimator.offline.progress import approached
from estimator.offline.record.prepare import Samples, fast_speed, prepare
from estimator.offline.split import Split, split
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.process.arrays import Array

Method = Literal["batch", "sample", "nls"]
Formulation = Literal["auto", "algebraic", "output_error"]
Progress = Callable[[str, float], None]

EXAMINED, PREPARED, BATCHED, FITTED, SCORED = 0.1, 0.15, 0.2, 0.8, 0.85
"""Shares of the time of a fit to all samples of a quarter of an hour, at the end of its parts; a report is the rest."""
TYPICAL_SIMULATIONS = 25
"""of a fit"""

REPAIR_ROUNDS = 3
"""Times that what a fit finds wrong with the log is taken out and estimated again: a delay in it is of first order."""
FORCE_ROUNDS = 3
"""Fits of a fast car's forces at most, each from the end of the one before it."""


@dataclass(frozen=True)
class Options:
    """What to do; `keep` names health findings that are reported but not acted on."""

    layout: Layout = "per_axle"
    method: Method = "nls"
    formulation: Formulation = "auto"
    window_s: float = OutputErrorSettings.window_s
    keep: frozenset[str] = frozenset()


@dataclass(frozen=True)
class Fitted:
    """A fit with what it was made of."""

    samples: Samples
    split: Split
    columns: ModelColumns
    fit: EquationErrorFit
    recursion: Recursion


def fit_and_repair(task: Task, health: HealthReport) -> tuple[Fitted, Task, HealthReport]:
    """Fit, repair the log by what the fit finds, fit again; what the fit found joins the log's health."""
    fitted = _fit_and_split(task, health)
    if _is_fast(task, health):
        fitted = _fit_with_forces(task, health, fitted)
    for _ in range(REPAIR_ROUNDS):
        again = any(finding.name == LAG_STEER for finding in health.findings)
        lag = lag_of(fitted.fit, task.log.step, again)
        if lag is None:
            break
        task, health = _repaired(task, health, [lag])
        fitted = _fit_and_split(task, health, without(fitted.fit, [lag]).values)
    fitted, task, health = _with_own_ay(fitted, task, health)
    if (zero := zero_of(fitted.fit)) is not None:
        health = health.replaced(zero)
    return fitted, task, health


def _fit_with_forces(task: Task, health: HealthReport, fitted: Fitted) -> Fitted:
    """The forces of a fast car fitted as well, from where `fitted` is; on from there while it tells vy and yaw rate.

    The way to them is long and bent, and steps are few: a fit may end far from a minimum. What ax leaves weighs as much
    as vy and yaw rate, so that a further fit may also gain there what it loses across the car: that one is none.
    """
    best = _fit_and_split(task, health, fitted.fit.values)
    for _ in range(FORCE_ROUNDS - 1):
        if best.fit.converged:
            break
        further = _fit_and_split(task, health, best.fit.values)
        if _left_across(further.fit) >= _left_across(best.fit):
            break
        best = further
    return best


def _left_across(fit: EquationErrorFit) -> float:
    """Logarithm of the product of what a fit leaves of vy and yaw rate; 0 where it simulates neither."""
    return float(np.log([fit.spread[name] for name in ("vy", "yaw_rate") if name in fit.spread]).sum())


def _with_own_ay(fitted: Fitted, task: Task, health: HealthReport) -> tuple[Fitted, Task, HealthReport]:
    """What the fit says of vy and yaw rate taken out of the log, and of the fit, where a derived ay depends on it.

    Log health sees where vy is measured through tyres without downforce: at speed it is a metre and more off, and so
    much of the yaw acceleration is then in the derived ay. There is nothing to fit again: vy is linear in its place,
    and of the lag milliseconds are left. A further fit finds another minimum instead, as what ax leaves weighs as much
    as vy and yaw rate: three timings that are hardly told apart move far along it.
    """
    derived = "ay" in task.log.derived and _is_fast(task, health)
    if not (derived and moves_ay(fitted.fit, fast_speed(task.log))):
        return fitted, task, health
    found = [one for one in (lag_left(fitted.fit), place_left(fitted.fit)) if one is not None]
    task, health = _repaired(task, health, found)
    samples = prepare(task.log)
    fit = without(fitted.fit, found)
    return (
        replace(fitted, samples=samples, split=split(task.log, samples, task.vehicle.own_time), fit=fit),
        task,
        health,
    )


def _repaired(task: Task, health: HealthReport, found: Iterable[LogFinding]) -> tuple[Task, HealthReport]:
    """The log without what was found."""
    health = on_one_bandwidth(reduce(HealthReport.repaired, found, health))
    return replace(task, log=health.log), health


def _fit_and_split(task: Task, health: HealthReport, known: Mapping[str, float] | None = None) -> Fitted:
    """A fit that may start from parameters that are `known`; only then a fast car's forces are fitted as well."""
    task.progress("smoothing", EXAMINED)
    samples = prepare(task.log)
    divided = split(task.log, samples, task.vehicle.own_time)
    columns = _columns(task, health, with_forces=known is not None)
    train, test = samples.select(divided.train), samples.select(divided.test)
    result, recursion = _fit(task, columns, train, test, known)
    return Fitted(samples, divided, columns, result, recursion)


@dataclass(frozen=True)
class Task:
    """What all steps of one identification share."""

    log: DriveLog
    vehicle: Vehicle
    prior: Mapping[str, float]
    options: Options
    formulation: Formulation
    progress: Progress


def formulation_of(options: Options, log: DriveLog) -> Formulation:
    """The recursions are algebraic; a full fit simulates: neither noisy slip angles nor bad accelerations bias it.

    One tyre for both axles fixes the car's balance, and what is simulated shows that error many times over: where
    accelerations were measured, their fit is the better one then.
    """
    if options.method != "nls":
        return "algebraic"
    if options.formulation != "auto":
        return options.formulation
    return "algebraic" if options.layout == "shared" and _accelerations_measured(log) else "output_error"


def _accelerations_measured(log: DriveLog) -> bool:
    return not {"ax", "ay"} & set(log.derived)


def _columns(task: Task, health: HealthReport, *, with_forces: bool) -> ModelColumns:
    options = task.options
    nuisances: list[Effect] = []
    if LAG_STEER not in options.keep:
        nuisances.append(steer_timing(task.log.step))
    if health.steering_is_off:
        nuisances.append(steer_zero())
    if task.formulation == "output_error" and health.vy_is_displaced and not health.vy_was_placed:
        nuisances.append(vy_sensor())
    if KNOWN_BANK in task.log:
        nuisances.append(known_bank(ay_is_derived="ay" in task.log.derived))
    if _is_fast(task, health):
        nuisances += [*loads(), *(forces() if with_forces else ())]
    if task.formulation == "output_error" and health.yaw_rate_was_moved:
        nuisances.append(yaw_rate_timing())
    return ModelColumns(SingleTrack(task.vehicle, task.prior, tuple(nuisances)))


def _is_fast(task: Task, health: HealthReport) -> bool:
    """Whether the air presses on a car whose own logger recorded it; a log of other sensors is taken as it is."""
    own_logger = health.lateral_was_repaired and "ay" in task.log.derived
    own_logger = own_logger and presses(fast_speed(task.log), task.vehicle)
    return KNOWN_BANK in task.log or own_logger


def _fit(
    task: Task, columns: ModelColumns, train: Samples, held_out: Samples, known: Mapping[str, float] | None
) -> tuple[EquationErrorFit, Recursion]:
    recursion = _recursion(task, columns, train, held_out)
    if task.options.method != "nls":
        return recursion.fit, recursion
    task.progress("nonlinear least squares", BATCHED)
    trusted = _accelerations_measured(task.log)
    start = fit(columns, averaged(train)) if trusted or task.formulation == "algebraic" else None
    if start is not None and task.formulation == "algebraic":
        return start, recursion
    outputs = ("vy", "yaw_rate", "ay") if trusted else ("vy", "yaw_rate")
    settings = OutputErrorSettings(window_s=task.options.window_s, outputs=outputs)
    candidates = [columns.start, *(_placed(columns, one) for one in (start and start.values, known) if one)]
    return fit_output_error(columns, task.log, train, settings, candidates, _simulating(task)), recursion


def _placed(columns: ModelColumns, values: Mapping[str, float]) -> Array:
    """(p,) the model's start with the `values` that are known of it."""
    each = zip(columns.parameters, columns.start.tolist(), strict=True)
    return np.array([values.get(parameter.name, start) for parameter, start in each])


def _simulating(task: Task) -> Callable[[], None]:
    """What is told of every simulation of the fit."""
    steps = itertools.count(1)
    return lambda: task.progress("simulations", approached(BATCHED, FITTED, next(steps), TYPICAL_SIMULATIONS))


def _recursion(task: Task, columns: ModelColumns, train: Samples, held_out: Samples) -> Recursion:
    method = sample if task.options.method == "sample" else batch
    name = "sample by sample" if task.options.method == "sample" else "batches"
    last = BATCHED if task.options.method == "nls" else FITTED
    return method(
        columns, averaged(train), held_out, lambda share: task.progress(name, PREPARED + (last - PREPARED) * share)
    )
