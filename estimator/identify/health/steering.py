"""Lag of the road wheels behind the reported steering: servo, column and command path.

The lag is fitted along with the tyres, so that what the car's own dynamics delay is not taken for it. The delay is
first order in the model, so the log is shifted by what was found and the rest is estimated again.
"""

from __future__ import annotations

import numpy as np

from estimator.identify.drive_log import DriveLog
from estimator.identify.evaluate import ModelColumns
from estimator.identify.fit import FitSettings, fit
from estimator.identify.health.finding import Action, Finding, confidence_of
from estimator.identify.health.offsets import shifted
from estimator.identify.nuisance import STEER_TIMING, steer_timing
from estimator.identify.prepare import prepare
from estimator.identify.recursive import averaged
from estimator.model.single_track import SingleTrack
from hil_gateway.vehicle import Vehicle

LEAST_SAMPLES = 1.5
LEAST_S = 0.015
LONGEST_S = 0.2
WELL_KNOWN_S = 0.005
"""A lag that is not known to this, or longer than any servo's, is the fit's escape from something else."""

ROUNDS = 3


def find(log: DriveLog, vehicle: Vehicle) -> list[Finding]:
    """Steering lag beyond what a fit estimates by itself."""
    size, std = steering_lag(log, vehicle)
    least = max(LEAST_S, LEAST_SAMPLES * log.step)
    if not least < size < LONGEST_S or std > WELL_KNOWN_S:
        return []
    text = f"the road wheels lag the reported steering by {1000 * size:.0f} ms"

    def repair(log: DriveLog) -> DriveLog:
        return shifted(log, "steer", -size)

    return [
        Finding("lag_steer", "steer", text, size, std, "s", confidence_of(size, std, least), Action.REALIGNED, repair)
    ]


def steering_lag(log: DriveLog, vehicle: Vehicle) -> tuple[float, float]:
    """(lag, standard deviation) of the steering behind its report, s."""
    columns = ModelColumns(SingleTrack(vehicle, "per_axle", (steer_timing(log.step),)))
    total, std, start = 0.0, np.inf, None
    for _ in range(ROUNDS):
        moved = shifted(log, "steer", -total) if total else log
        result = fit(columns, averaged(prepare(moved)), FitSettings(channels=("ay", "yaw_acc")), start)
        rest, std = result.values[f"{STEER_TIMING}.tau"], result.std[f"{STEER_TIMING}.tau"]
        total, start = total + rest, result.theta
        if abs(rest) < max(std, 0.2 * log.step):
            break
    return total, float(std)
