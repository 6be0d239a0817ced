"""The bank of a road as an input of an identification, found before any tyre is fitted."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from estimator.drive_log.derived import smoothed
from estimator.drive_log.table import DriveLog
from estimator.model.effects import effect_with
from estimator.model.parameters import Quantity
from estimator.offline.health import HealthReport, examine
from estimator.offline.health.acceleration import kinematic, rederived
from estimator.offline.record.record import make_record
from estimator.offline.record.road import find_road, finer_by_roll
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.process.arrays import Array
from hil_gateway.process.errors import InputError

STEEP = 0.1
"""rad between the extremes of the lap; less changes the lateral force by less than sensors of a car's own logger do"""


def examine_on_its_road(log: DriveLog, vehicle: Vehicle, keep: Collection[str] = ()) -> HealthReport:
    """Log health; where the repaired log shows a bank it becomes an input."""
    health = examine(log, vehicle, keep)
    bank = _bank_of(health.log, vehicle, health.doubtful)
    log = health.log if bank is None else _with_known_bank(health.log, bank)
    return on_one_bandwidth(replace(health, log=log))


def _bank_of(log: DriveLog, vehicle: Vehicle, distrusted: Collection[str]) -> Array | None:
    """(n,) bank under the car, rad, left side up positive; None on a road about level, or where nothing tells."""
    try:
        record = make_record(log, vehicle, distrusted)
    except InputError:  # too short for laps, which `identify` itself need not have
        return None
    profile = find_road(record).get(effect_with(Quantity.BANK).name)
    if profile is None:
        return None
    position = record.signals["track_position"]
    bank = record.bases["track_position"].matrix(position) @ profile.coefficients
    if np.ptp(bank) <= STEEP:
        return None
    finer = finer_by_roll(record, record.thin(bank))
    return np.asarray(bank if finer is None else bank + finer[0].matrix(position) @ finer[1])


def on_one_bandwidth(health: HealthReport) -> HealthReport:
    """The yaw rate in a derived ay smoothed as d/dt vy is: its noise, times vx, is no acceleration."""
    log = health.log
    if "ay" not in log.derived:
        return health
    turning = log["vx"] * log["yaw_rate"]
    ay = kinematic(log)["ay"] + smoothed(log["t"], turning, log.segment) - turning
    return replace(health, log=log.with_columns({"ay": ay}, "vx yaw_rate in the derived ay is smoothed as d/dt vy is"))


def _with_known_bank(log: DriveLog, bank: Array) -> DriveLog:
    """The log with its bank; an ay that was derived from velocities becomes what an accelerometer would feel."""
    low, high = np.degrees(np.quantile(bank, (0.02, 0.98)))
    banked = log.with_columns(
        {"known_bank": bank}, f"the road is banked by {low:.1f} to {high:.1f} deg (left side up positive)"
    )
    return rederived(banked, ("ay",), "ay derived with the bank") if "ay" in log.derived else banked
