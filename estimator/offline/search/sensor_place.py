"""Where the accelerometer lies, how speed and yaw rate are scaled and what the gyroscope's zero is.

By kinematics alone, whatever tyres and steering do.

d/dt vy + vx w - ay = -g sin(bank) - x dw/dt for a sensor x ahead of the centre of gravity. All of it passes the same
smoothing kernel, so that the filter cancels: smoothing vy alone would look like a sensor that is displaced.
"""

from __future__ import annotations

import numpy as np

from estimator.offline.record.derivative import kernel, stretches
from estimator.offline.record.record import MEASURED, Record
from estimator.offline.record.road import PRIOR_STD, SENSORS
from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.process.arrays import Array, Ints

AX, AY, YAW_RATE, VX, VY = range(len(MEASURED))
TRIMMED = 0.05
"""share of the windows at either end that does not count: a receiver jumped"""


def accelerometer_ahead(record: Record) -> tuple[float, float] | None:
    """Metres that the accelerometer lies ahead of the centre of gravity, and their standard deviation.

    None where ay, yaw rate or vy is no sensor of its own.
    """
    if not record.used[[AY, YAW_RATE, VY]].all():
        return None
    parts = [_equation(record, rows) for rows in stretches(np.sort(record.rows.ravel()), record.step, record.kernel_s)]
    y, X = (np.concatenate(part) for part in zip(*parts, strict=True))
    precision = np.zeros((X.shape[1],) * 2)
    own = len(SENSORS)
    precision[:own, :own] = np.diag([1.0 / std**2 for std in SENSORS.values()])
    if "track_position" in record.bases:
        precision[own:, own:] = record.bases["track_position"].precision(GRAVITY * PRIOR_STD)
    variance = float(np.mean((y - X @ np.linalg.lstsq(X, y, rcond=None)[0]) ** 2))
    covariance = np.linalg.inv(X.T @ X / variance + precision)
    at = list(SENSORS).index("arm")
    return -float((covariance @ X.T @ y)[at] / variance), float(np.sqrt(covariance[at, at]))


def _equation(record: Record, rows: Ints) -> tuple[Array, Array]:
    """Left side (n,) and columns (n, k) over one stretch, in the order of `SENSORS`, then the road's.

    One row per half length of the kernel: closer ones say the same.
    """
    smooth, slope = kernel(record.step, record.kernel_s)
    half = len(smooth) // 2
    measured = record.measured[:, rows]

    def smoothed(signal: Array) -> Array:
        return np.convolve(signal, smooth, "valid")[::half]

    def derivative(signal: Array) -> Array:
        return np.convolve(signal, slope, "valid")[::half]

    y = derivative(measured[VY]) + smoothed(measured[VX] * measured[YAW_RATE] - measured[AY])
    turning = derivative(measured[YAW_RATE])
    columns = [np.ones_like(y), *(smoothed(measured[i]) for i in (AY, AX)), turning,
               smoothed(measured[YAW_RATE] ** 2), smoothed(measured[VX])]  # fmt: skip
    X = np.stack(columns, axis=1)
    if "track_position" not in record.bases:
        return y, X
    place = record.signals["track_position"][rows][half:-half][::half]
    return y, np.concatenate([X, record.bases["track_position"].matrix(place)], axis=1)


def speed_scale(record: Record) -> tuple[float, float] | None:
    """Reported speed over that of the positions, and its standard deviation; None without positions.

    The trimmed mean over windows: positions may be held or jump.
    """
    if not {"x", "y"} <= record.signals.keys():
        return None
    stride = max(1, round(record.kernel_s / record.step))  # turns by 0.1 rad at most, and drives far against noise
    rows = record.rows.reshape(record.windows, -1)
    ends = rows[:, ::stride]
    x, y, vx, vy = (record.signals[name] for name in ("x", "y", "vx", "vy"))
    driven = np.hypot(np.diff(x[ends]), np.diff(y[ends])).sum(axis=1)
    last = (ends.shape[1] - 1) * stride
    reported = np.hypot(vx, vy)[rows[:, :last]].mean(axis=1) * last * record.step
    cut = int(TRIMMED * record.windows)
    inverse = np.sort(driven / reported)[cut : record.windows - cut]
    scale = 1.0 / max(float(inverse.mean()), np.finfo(float).tiny)
    return scale, float(inverse.std() / np.sqrt(len(inverse))) * scale**2


def gyro_gain(record: Record) -> tuple[float, float] | None:
    """Reported yaw rate over that of the heading, and its standard deviation; None without a heading.

    The zero of the gyroscope is estimated along with it, over windows.
    """
    if "yaw" not in record.signals:
        return None
    rows = record.rows.reshape(record.windows, -1)
    ends = record.signals["yaw"][rows[:, [0, -1]]]
    turned = np.angle(np.exp(1j * np.diff(ends, axis=1)[:, 0]))
    rate = record.measured[YAW_RATE][rows]
    reported = (rate.sum(axis=1) - 0.5 * (rate[:, 0] + rate[:, -1])) * record.step
    X = np.stack([turned, np.ones_like(turned)], axis=1)
    found, *_ = np.linalg.lstsq(X, reported, rcond=None)
    variance = float(np.mean((reported - X @ found) ** 2))
    return float(found[0]), float(np.sqrt(variance * np.linalg.pinv(X.T @ X)[0, 0]))


def gyroscope_zero(record: Record) -> tuple[float, float] | None:
    """Reported yaw rate less that of the course, rad/s, and its standard deviation; None without positions.

    Within windows; what the side slip changes meanwhile adds up to nothing.
    """
    if not {"x", "y"} <= record.signals.keys():
        return None
    stride = max(1, round(record.kernel_s / record.step))  # turns by 0.1 rad at most, and drives far against noise
    rows = record.rows.reshape(record.windows, -1)
    ends = rows[:, ::stride]
    north, east = (np.diff(record.signals[name][ends]) for name in ("y", "x"))
    course = np.unwrap(np.arctan2(north, east), axis=1)
    first, length = stride // 2, (course.shape[1] - 1) * stride
    reported = record.measured[YAW_RATE, rows[:, first : first + length]].mean(axis=1)
    cut = int(TRIMMED * record.windows)
    zero = np.sort(reported - (course[:, -1] - course[:, 0]) / (length * record.step))[cut : record.windows - cut]
    return float(zero.mean()), float(zero.std() / np.sqrt(len(zero)))
