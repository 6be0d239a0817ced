"""Scale of the wheel speeds against vx: a wrong rolling radius makes slip of nothing."""

from __future__ import annotations

import numpy as np

from estimator.drive_log.lag import PARTS
from estimator.drive_log.table import DriveLog
from estimator.offline.health.finding import LEAST_ERRORS, LogFinding, confidence_of
from estimator.offline.record.prepare import moving_speed
from hil_gateway.car.vehicle import Vehicle

LEAST_SCALE = 0.005


def find(log: DriveLog, vehicle: Vehicle) -> list[LogFinding]:
    """Axles whose wheels report a speed off by more than half a percent on average."""
    findings = []
    moving = log["vx"] > moving_speed(log)
    for axle, names in {
        "front": ("wheel_speed_fl", "wheel_speed_fr"),
        "rear": ("wheel_speed_rl", "wheel_speed_rr"),
    }.items():
        if not set(names) <= log.columns.keys():
            continue
        speed = 0.5 * (log[names[0]] + log[names[1]])[moving]
        parts = [float(np.median(r)) for r in np.array_split(speed / log["vx"][moving], PARTS)]
        scale, std = float(np.median(parts)) - 1.0, float(np.std(parts) / np.sqrt(PARTS))
        if abs(scale) > LEAST_SCALE and abs(scale) > LEAST_ERRORS * std:
            text = f"{axle} wheel speeds are {100 * scale:+.1f} % off vx: rolling radius or speed scale"
            confidence = confidence_of(scale, std, LEAST_SCALE)
            findings.append(
                LogFinding(f"scale_{axle}_wheels", f"wheel_speed_{axle[0]}*", text, scale, std, "1", confidence)
            )
    return findings
