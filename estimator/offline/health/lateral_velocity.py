"""Where vy is measured, and how the sensor is turned: seen while the tyres slip little.

At small slip the rear axle runs nearly where it points: vy at the CoG is lr yaw_rate less vx times a slip that grows
with the rear axle's force, which Eq. (1) gives from ay and the yaw acceleration. So vy as reported =
(lr + x) yaw_rate + angle vx + bias - vx (k ay + l yaw_acc + m ay^3), linear in the unknowns.

Downforce makes the tyres stiffer with vx^2 and is estimated along; a bank that the equation does not know shows there
too. Where ay is a sensor of its own, d/dt vy + vx yaw_rate - ay = x yaw_acc tells how far ahead of it vy is measured,
whatever road and tyres do: the tyres then only say which of both is not at the CoG.
"""

from __future__ import annotations

import numpy as np

from estimator.drive_log.derived import derivative, smoothed
from estimator.drive_log.table import DriveLog
from estimator.model.effect import VY_SENSOR
from estimator.offline.fit.equation_error import EquationErrorFit
from estimator.offline.health.finding import Action, LogFinding, confidence_of
from estimator.offline.health.regression import PARTS, jackknifed
from estimator.offline.health.straight import goes_straight
from estimator.offline.record.prepare import moving_speed, prepare
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.process.arrays import Array

POSITION_VY, UNKNOWN_PLACE = "position_vy", "unknown_place_vy"
GENTLE_SHARE = 0.35
"""Only samples below this share of the log's hardest cornering are used."""

LEAST_ANGLE = 0.004
"""rad; less is within what tyres and road do"""

LEAST_POSITION, LEAST_STD = 0.1, 5.0
"""share of the wheelbase; standard deviations of either estimate, which know nothing of what the equations lack"""

DOWNFORCES = (0.0, 0.5, 1.0, 2.0)
"""Downforce at the log's largest speed over the weight: none, and up to that of an IndyCar at 85 m/s"""


def find(log: DriveLog, vehicle: Vehicle) -> list[LogFinding]:
    """Misalignment with bias, and position, of the sensor of vy."""
    estimate = sensor_of_vy(log, vehicle)
    if estimate is None:
        return []
    (x, angle, bias), std = estimate
    speed = float(np.median(log["vx"][log["vx"] > moving_speed(log)]))
    parts = ((angle, std[1]), (bias / speed, std[2] / speed))
    turned = any(abs(size) > LEAST_ANGLE and abs(size) > LEAST_STD * error for size, error in parts)
    findings = [_misaligned(angle, bias, speed, (float(std[1]), float(std[2])))] if turned else []
    return findings + _place_of(log, (float(x), float(std[0])), LEAST_POSITION * vehicle.wheelbase)


def _place_of(log: DriveLog, by_tyres: tuple[float, float], least: float) -> list[LogFinding]:
    """Where vy is measured: as far from the accelerometer as it moves against it, if the tyres are nearer to that."""
    felt = None if "ay" in log.derived else ahead_of_accelerometer(log)
    if felt is not None and abs(by_tyres[0] - felt[0]) > abs(by_tyres[0]):
        tell = abs(felt[0]) > max(least, LEAST_STD * felt[1])
        return [_apart(*felt) if abs(by_tyres[0]) < least else _unknown(*felt)] if tell else []
    x, std = felt or by_tyres
    if abs(x) > max(least, LEAST_STD * std):
        return [_displaced(x, std, least)]
    return [_unknown(x, std)] if np.hypot(x, std) > least else []


def sensor_of_vy(log: DriveLog, vehicle: Vehicle) -> tuple[Array, Array] | None:
    """(x ahead of the CoG m, angle rad, bias m/s) and their standard deviations by the tyres; None without gentle
    driving on straights or in turns both ways."""
    samples = prepare(log)
    vx, yaw_rate, vy = samples["vx"], samples["yaw_rate"], log["vy"][samples.row]
    if not goes_straight(yaw_rate / vx):  # on one circle the yaw rate is a multiple of vx
        return None
    cornering = np.abs(vx * yaw_rate)
    gentle = cornering < GENTLE_SHARE * np.quantile(cornering, 0.99)
    if gentle.sum() < 50 * PARTS:
        return None
    slip, fast = vx * samples["ay"], (vx / vx.max()) ** 2
    free = [yaw_rate, vx, np.ones_like(vx), vx * samples["yaw_acc"], slip * samples["ay"] ** 2]
    tried = [np.stack([*free, slip / (1.0 + share * fast)], axis=1)[gentle] for share in DOWNFORCES]
    best = min(tried, key=lambda X: float(np.linalg.lstsq(X, vy[gentle], rcond=None)[1].sum()))
    whole, spread = jackknifed(best, vy[gentle])
    whole[0] -= vehicle.lr
    return whole[:3], spread[:3]


def ahead_of_accelerometer(log: DriveLog) -> tuple[float, float]:
    """Metres that vy is measured ahead of ay, and their standard deviation; all passes one kernel, which cancels."""
    t, segment, moving = log["t"], log.segment, log["vx"] > moving_speed(log)
    turning, ay, ax, square, vx = (
        smoothed(t, signal, segment)
        for signal in (log["vx"] * log["yaw_rate"], log["ay"], log["ax"], log["yaw_rate"] ** 2, log["vx"])
    )
    X = np.stack([derivative(t, log["yaw_rate"], segment), ay, np.ones_like(ay), ax, square, vx], axis=1)[moving]
    seen, std = jackknifed(X, (derivative(t, log["vy"], segment) + turning - ay)[moving])
    return float(seen[0]), float(std[0])


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


def _apart(x: float, std: float) -> LogFinding:
    text = f"vy is measured {x:+.2f} +- {std:.2f} m ahead of ay; by the tyres it is ay that is not at the CoG"
    return LogFinding("position_ay", "ay", text, -x, std, "m", confidence_of(x, std, 0.0))


def _unknown(x: float, std: float) -> LogFinding:
    """`size` is how far off the CoG vy may be measured, as a standard deviation."""
    text = (
        f"vy is measured {x:+.2f} +- {std:.2f} m ahead of the CoG, as far as the log tells; an ay of its own, or bends"
        " at many speeds, tell more"
    )
    off = float(np.hypot(x, std))
    return LogFinding(UNKNOWN_PLACE, "vy", text, off, std, "m", 0.0)


def _place(x: float) -> str:
    return f"vy is measured {abs(x):.2f} m {'ahead of' if x > 0 else 'behind'} the centre of gravity"
