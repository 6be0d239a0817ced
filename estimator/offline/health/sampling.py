"""Sampling, gaps and quantised channels."""

from __future__ import annotations

import itertools

import numpy as np

from estimator.drive_log.smoothing import wiener
from estimator.drive_log.table import DERIVABLE, REQUIRED, DriveLog
from estimator.offline.health.finding import LogFinding
from estimator.offline.record.prepare import moving_speed
from hil_gateway.car.vehicle import Vehicle

MOTION = ("vx", "vy", "yaw_rate", "ax", "ay", "x", "y")
JITTER_SHARE = 0.2
"""Time steps that deviate by more than this share of the median are worth a word."""

COARSE = 1.0
"""A channel is coarse when its resolution exceeds so many standard deviations of its noise."""


def find(log: DriveLog, vehicle: Vehicle) -> list[LogFinding]:
    """Irregular time steps, gaps, channels that are held over rows, and those whose resolution hides their noise."""
    return [*_jitter(log), *_gaps(log), *_held(log), *_quantised(log)]


def _inner_steps(log: DriveLog) -> np.ndarray:
    return np.asarray(np.diff(log["t"])[np.diff(log.segment) == 0])


def _jitter(log: DriveLog) -> list[LogFinding]:
    deviation = np.abs(_inner_steps(log) / log.step - 1.0)
    share = float(np.mean(deviation > JITTER_SHARE))
    if share < 1e-3:
        return []
    text = (
        f"{100 * share:.1f} % of the time steps deviate by more than {100 * JITTER_SHARE:.0f} % from {log.step:.4g} s"
    )
    return [LogFinding("irregular_steps", "t", text, share, 0.0, "1", 1.0)]


def _gaps(log: DriveLog) -> list[LogFinding]:
    segments = log.segments()
    if len(segments) < 2:
        return []
    lost = sum(log["t"][b.start] - log["t"][a.stop - 1] for a, b in itertools.pairwise(segments))
    text = f"{len(segments) - 1} gaps, {lost:.3g} s in all; nothing is computed across them"
    return [LogFinding("gaps", "t", text, float(lost), 0.0, "s", 1.0)]


def _held(log: DriveLog) -> list[LogFinding]:
    """What moves the car and stays as it was in most rows comes more slowly than these, or in coarse steps."""
    moving = (log["vx"] > moving_speed(log))[1:]
    findings = []
    for name in (n for n in MOTION if n in log and n not in log.derived and moving.any()):
        share = float(np.mean(np.diff(log[name])[moving] == 0.0))
        if share > 0.5:
            text = f"{name} stays as it was in {100 * share:.0f} % of the rows: it is slower, or in coarse steps"
            findings.append(LogFinding(f"held_{name}", name, text, share, 0.0, "1", 1.0))
    return findings


def _quantised(log: DriveLog) -> list[LogFinding]:
    findings = []
    for name in (*REQUIRED[1:], *DERIVABLE):
        if name in log.derived:
            continue
        resolution = resolution_of(log[name])
        noise = wiener(log[name], log.step).noise
        if resolution > COARSE * max(noise, 1e-12) and resolution > 0.002 * float(np.std(log[name])):
            text = f"{name} has a resolution of {resolution:.3g}, coarser than its noise, {noise:.2g} (SI)"
            findings.append(LogFinding(f"quantised_{name}", name, text, resolution, 0.0, "SI", 1.0))
    return findings


def resolution_of(values: np.ndarray) -> float:
    """Step of a quantised channel: the smallest difference that occurs, if all values are multiples of it; else 0."""
    levels = np.unique(values)
    if len(levels) < 3 or len(levels) > len(values) // 4:
        return 0.0
    steps = np.diff(levels)
    step = float(np.quantile(steps, 0.05))
    if step <= 0.0:
        return 0.0
    off = np.abs(steps / step - np.round(steps / step))
    return step if float(np.median(off)) < 0.05 else 0.0
