"""Time offsets between channels that record the same motion.

The yaw rate is compared with what other sensors say of it: heading, front wheel speeds, curvature from the steering,
lateral acceleration. Only if they agree among themselves that it is late (or early) is it moved.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.drive_log.derived import derivative
from estimator.drive_log.lag import Lag, lag_between
from estimator.drive_log.table import DriveLog
from estimator.offline.fit.equation_error import EquationErrorFit
from estimator.offline.health.finding import Action, LogFinding, confidence_of
from estimator.offline.predict.nuisance import YAW_RATE_TIMING
from estimator.offline.record.prepare import moving_speed
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.process.arrays import Array

OFFSET_YAW_RATE = "offset_yaw_rate"
LONGEST_S = 1.0
LEAST_S = 0.08
"""Smaller offsets are within what a car does between steering and yaw rate; the fit estimates that of the steering."""

MIN_CORRELATION = 0.3


def find(log: DriveLog, vehicle: Vehicle) -> list[LogFinding]:
    """Offset of the yaw rate against its witnesses."""
    lags = yaw_rate_lags(log, vehicle)
    if not lags:
        return []
    values = np.array([lag.value for lag in lags.values()])
    weights = np.array([lag.correlation**2 / (lag.std**2 + 0.03**2) for lag in lags.values()])
    size = _weighted_median(values, weights)
    agreeing = np.abs(values - size) < 0.1
    if abs(size) < LEAST_S or agreeing.sum() < min(2, len(values)):
        return []
    std = float(np.sqrt(np.sum((weights * (values - size))[agreeing] ** 2)) / weights[agreeing].sum() + 0.25 * log.step)
    direction = "lags" if size > 0 else "leads"
    witnesses = ", ".join(
        f"{name} {lag.value:+.2f} s (correlation {lag.correlation:.2f})" for name, lag in lags.items()
    )
    text = f"yaw_rate {direction} by {abs(size):.2f} s: against {witnesses}"

    def repair(log: DriveLog) -> DriveLog:
        return shifted(log, "yaw_rate", size)

    return [
        LogFinding(
            OFFSET_YAW_RATE, "yaw_rate", text, size, std, "s", confidence_of(size, std, LEAST_S),
            Action.REALIGNED, repair,
        )
    ]  # fmt: skip


def lag_left(fit: EquationErrorFit) -> LogFinding | None:
    """What `fit` says is left of the yaw rate's lag after log health moved it; None where it did not estimate that."""
    name = f"{YAW_RATE_TIMING}.tau"
    if name not in fit.values:
        return None
    size, std = fit.values[name], fit.std[name]

    def repair(log: DriveLog) -> DriveLog:
        return shifted(log, "yaw_rate", size)

    return LogFinding(
        OFFSET_YAW_RATE, "yaw_rate", _text(size), size, std, "s", confidence_of(size, std, 0.0),
        Action.REALIGNED, repair, _text,
    )  # fmt: skip


def _text(size: float) -> str:
    return f"yaw_rate {'lags' if size > 0 else 'leads'} by {abs(size):.3f} s, estimated with the tyres"


def yaw_rate_lags(log: DriveLog, vehicle: Vehicle) -> dict[str, Lag]:
    """witness -> lag of the yaw rate behind it, where they correlate."""
    moving = log["vx"] > moving_speed(log)
    lags = {}
    for name, (witness, usable) in _witnesses(log, vehicle).items():
        lag = lag_between(witness, log["yaw_rate"], moving & usable, log.step, LONGEST_S)
        if lag is not None and lag.correlation > MIN_CORRELATION:
            lags[name] = lag
    return lags


def _witnesses(log: DriveLog, vehicle: Vehicle) -> dict[str, tuple[Array, NDArray[np.bool_]]]:
    """name -> yaw rate it implies, rad/s, and where it can be used."""
    everywhere = np.ones(len(log), bool)
    witnesses = {"steer": (log["steer"] * log["vx"] / vehicle.wheelbase, everywhere)}
    if "yaw" in log:
        heading = derivative(log["t"], np.unwrap(log["yaw"]), log.segment)
        witnesses["yaw"] = (heading, without_glitches(heading, log["yaw_rate"]))
    if {"wheel_speed_fl", "wheel_speed_fr"} <= log.columns.keys():
        difference = log["wheel_speed_fr"] - log["wheel_speed_fl"]
        witnesses["front wheels"] = (difference / vehicle.track_front, everywhere)
    if "ay" not in log.derived:
        witnesses["ay"] = (log["ay"] / np.maximum(log["vx"], 1.0), everywhere)
    return witnesses


def without_glitches(values: Array, like: Array) -> NDArray[np.bool_]:
    """Where `values` stay within three times the range of `like`, and half a window around where they do not."""
    wild = np.abs(values) > 3.0 * float(np.quantile(np.abs(like), 0.99))
    return np.asarray(np.convolve(wild.astype(float), np.ones(9), "same") < 0.5)


def shifted(log: DriveLog, name: str, lag: float) -> DriveLog:
    """`log` with column `name` moved earlier by `lag` s; rows that lose their value are left out, and said so."""
    t = log["t"]
    moved = np.interp(t + lag, t, log[name])
    lost = (t + lag > t[-1]) | (t + lag < t[0])
    for a, b in zip(log.segments()[:-1], log.segments()[1:], strict=True):
        edge = t[a.stop - 1], t[b.start]
        lost |= (t + lag > edge[0]) & (t <= edge[0]) if lag > 0 else (t + lag < edge[1]) & (t >= edge[1])
    note = f"{name} moved earlier by {lag:.3f} s; {int(lost.sum())} rows without a value are left out"
    return log.with_columns({name: moved}, note).select(~lost)


def _weighted_median(values: Array, weights: Array) -> float:
    order = np.argsort(values)
    share = np.cumsum(weights[order]) / weights.sum()
    return float(values[order][np.searchsorted(share, 0.5)])
