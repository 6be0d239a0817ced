"""Where vy is measured, and how the sensor is turned: seen while the tyres slip little.

At small slip the rear axle runs nearly where it points: vy at the CoG is lr yaw_rate less vx times a slip that grows
with the rear axle's force, which Eq. (1) gives from ay and the yaw acceleration. So vy as reported =
(lr + x) yaw_rate + angle vx + bias - vx (k ay + l yaw_acc + m ay^3), linear in the unknowns.

A bank or downforce that the equation does not know shows there too. Where ay is a sensor of its own, a displaced vy
must also show in d/dt vy + vx yaw_rate - ay = x yaw_acc, which holds whatever road and tyres do.
"""

from __future__ import annotations

import numpy as np

from estimator.drive_log.table import DriveLog
from estimator.model.effect import VY_SENSOR
from estimator.offline.fit.equation_error import EquationErrorFit
from estimator.offline.health.finding import Action, LogFinding, confidence_of
from estimator.offline.health.regression import PARTS, jackknifed
from estimator.offline.health.straight import goes_straight
from estimator.offline.record.prepare import moving_speed, prepare
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.process.arrays import Array

POSITION_VY = "position_vy"
GENTLE_SHARE = 0.35
"""Only samples below this share of the log's hardest cornering are used."""

LEAST_ANGLE = 0.004
"""rad; less is within what tyres and road do"""

LEAST_POSITION = 0.2
"""share of the wheelbase"""

CONFIRMED_SHARE = 0.5
"""Share of a position seen by the tyres that the kinematics must confirm: both smooth, so that neither is exact."""


def find(log: DriveLog, vehicle: Vehicle) -> list[LogFinding]:
    """Misalignment with bias, and position, of the sensor of vy."""
    estimate = sensor_of_vy(log, vehicle)
    if estimate is None:
        return []
    (x, angle, bias), std = estimate
    speed = float(np.median(log["vx"][log["vx"] > moving_speed(log)]))
    findings = []
    parts = ((angle, std[1]), (bias / speed, std[2] / speed))
    if any(abs(size) > LEAST_ANGLE and abs(size) > 5.0 * error for size, error in parts):
        findings.append(_misaligned(angle, bias, speed, (float(std[1]), float(std[2]))))
    least = LEAST_POSITION * vehicle.wheelbase
    if abs(x) > least and abs(x) > 5.0 * std[0] and _confirmed(log, float(x)):
        findings.append(_displaced(x, float(std[0]), least))
    return findings


def sensor_of_vy(log: DriveLog, vehicle: Vehicle) -> tuple[Array, Array] | None:
    """(x ahead of the CoG m, angle rad, bias m/s) and their standard deviations; None without gentle driving
    on straights or in turns both ways."""
    samples = prepare(log)
    vx, yaw_rate, vy = samples["vx"], samples["yaw_rate"], log["vy"][samples.row]
    if not goes_straight(yaw_rate / vx):  # on one circle the yaw rate is a multiple of vx
        return None
    cornering = np.abs(vx * yaw_rate)
    gentle = cornering < GENTLE_SHARE * np.quantile(cornering, 0.99)
    if gentle.sum() < 50 * PARTS:
        return None
    force = samples["ay"]
    X = np.stack([yaw_rate, vx, np.ones_like(vx), vx * force, vx * samples["yaw_acc"], vx * force**3], axis=1)[gentle]
    whole, spread = jackknifed(X, vy[gentle])
    whole[0] -= vehicle.lr
    return whole[:3], spread[:3]


def _confirmed(log: DriveLog, x: float) -> bool:
    """Whether a vy measured `x` m ahead of the CoG agrees with a measured ay; nothing contradicts it without one."""
    if "ay" in log.derived:
        return True
    samples = prepare(log)
    felt, turning = samples["ay"], samples["vx"] * samples["yaw_rate"]
    X = np.stack([samples["yaw_acc"], felt, np.ones_like(felt)], axis=1)
    seen, std = jackknifed(X, samples["vy_dot"] + turning - felt)
    return bool(np.sign(x) * seen[0] > max(CONFIRMED_SHARE * abs(x), 2.0 * std[0]))


def _misaligned(angle: float, bias: float, speed: float, std: tuple[float, float]) -> LogFinding:
    turned, error = angle + bias / speed, float(np.hypot(std[0], std[1] / speed))
    text = (
        f"vy is turned by {np.degrees(turned):+.2f} deg at {speed:.0f} m/s (misalignment {np.degrees(angle):+.2f}"
        f" +- {np.degrees(std[0]):.2f} deg, bias {bias:+.3f} +- {std[1]:.3f} m/s): a side-slip that is not there"
    )

    def repair(log: DriveLog) -> DriveLog:
        corrected = log["vy"] - angle * log["vx"] - bias
        return log.with_columns({"vy": corrected}, f"vy less {angle:.4f} vx and {bias:.3f} m/s")

    return LogFinding(
        "offset_vy", "vy", text, turned, error, "rad", confidence_of(angle, std[0], 0.0), Action.CORRECTED, repair
    )


def place_left(fit: EquationErrorFit) -> LogFinding | None:
    """What `fit` says is left of the place of the sensor of vy; None where it did not estimate that."""
    name = f"{VY_SENSOR}.x"
    if name not in fit.values:
        return None
    return _displaced(fit.values[name], fit.std[name], 0.0)


def _displaced(x: float, std: float, least: float) -> LogFinding:
    def repair(log: DriveLog) -> DriveLog:
        return log.with_columns({"vy": log["vy"] - x * log["yaw_rate"]}, f"vy moved {x:.2f} m to the CoG")

    confidence = confidence_of(x, std, least)
    return LogFinding(POSITION_VY, "vy", _place(x), x, std, "m", confidence, Action.CORRECTED, repair, _place)


def _place(x: float) -> str:
    return f"vy is measured {abs(x):.2f} m {'ahead of' if x > 0 else 'behind'} the centre of gravity"
