"""Time offset of the speed: a receiver reports it late, and pedals and hills are then taken for what they are not.

The speed is compared with how the positions move, and its change with the accelerometer. Only if both say that it is
late (or early) is it moved: of the two alone either may be.
"""

from __future__ import annotations

import numpy as np

from estimator.drive_log.derived import derivative, specific_force
from estimator.drive_log.lag import Lag, lag_between
from estimator.drive_log.table import DriveLog
from estimator.offline.health.finding import LEAST_ERRORS, Action, LogFinding, confidence_of
from estimator.offline.health.offsets import LONGEST_S, MIN_CORRELATION, shifted
from estimator.offline.record.prepare import moving_speed
from hil_gateway.car.vehicle import Vehicle

OFFSET_VX = "offset_vx"
LEAST_S = 0.03
"""Smaller offsets are those of a filter of the speed: one of 5 Hz lags by so much."""


def find(log: DriveLog, vehicle: Vehicle) -> list[LogFinding]:
    """Offset of vx against positions and accelerometer."""
    lags = speed_lags(log)
    if len(lags) < 2:
        return []
    values, variances = np.array([[lag.value, lag.std**2] for lag in lags.values()]).T
    size = float(np.sum(values / variances) / np.sum(1.0 / variances))
    std = float(np.sqrt(1.0 / np.sum(1.0 / variances)))
    apart = abs(values[0] - values[1]) > LEAST_ERRORS * np.sqrt(variances.sum()) + log.step
    if apart or abs(size) < max(LEAST_S, LEAST_ERRORS * std):
        return []
    witnesses = ", ".join(f"{name} {lag.value:+.3f} s" for name, lag in lags.items())
    text = f"vx {'lags' if size > 0 else 'leads'} by {abs(size):.3f} s: against {witnesses}"

    def repair(log: DriveLog) -> DriveLog:
        return shifted(log, "vx", round(size / log.step) * log.step)  # what is between rows has other noise

    confidence = confidence_of(size, std, LEAST_S)
    return [LogFinding(OFFSET_VX, "vx", text, size, std, "s", confidence, Action.REALIGNED, repair)]


def speed_lags(log: DriveLog) -> dict[str, Lag]:
    """witness -> lag of the speed behind it, where they correlate."""
    moving, lags = log["vx"] > moving_speed(log), {}
    pairs = {}
    if "x" in log and "y" in log:
        velocity = [derivative(log["t"], log[name], log.segment) for name in ("x", "y")]
        pairs["positions"] = np.hypot(*velocity), log["vx"]
    if "ax" not in log.derived:
        pairs["ax"] = log["ax"], specific_force("ax", log.columns, log.segment)
    for name, (witness, own) in pairs.items():
        lag = lag_between(witness, own, moving, log.step, LONGEST_S)
        if lag is not None and lag.correlation > MIN_CORRELATION:
            lags[name] = lag
    return lags
