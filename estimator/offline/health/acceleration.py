"""Acceleration channels against the derivative of velocity: late, attenuated or unrelated ones are not used."""

from __future__ import annotations

import re

import numpy as np

from estimator.drive_log.derived import specific_force
from estimator.drive_log.lag import Lag, fast_part, lag_between
from estimator.drive_log.smoothing import second_difference_noise
from estimator.drive_log.table import DriveLog
from estimator.offline.health.finding import Action, LogFinding
from estimator.offline.health.units import MIN_CORRELATION
from estimator.offline.record.prepare import moving_speed
from hil_gateway.car.vehicle import GRAVITY, Vehicle
from hil_gateway.process.arrays import Array

LONGEST_S, SLOWEST = 2.5, 4.0
"""of a lag, and of the motion that tells one, over it"""
LATE_S = 0.15
GAIN_BAND = (0.6, 1.5)
LEAST_MOTION = 0.5
"""Share of the variance of an accelerometer below which noise hides whether it follows the velocities."""
BANKED_GAIN, BANKED_CORRELATION = 0.25, 0.9
"""A lateral accelerometer does not feel what a bank does: in steep bends down to a quarter of the centripetal
acceleration is left, and follows it closely all the same."""


def find(log: DriveLog, vehicle: Vehicle) -> list[LogFinding]:
    """ax, ay, and unknown columns named like them, that do not follow the velocities."""
    moving = log["vx"] > moving_speed(log)
    findings = []
    for axis, expected in kinematic(log).items():
        names = [axis] if axis not in log.derived else []
        names += [n for n in log.extra if re.match(rf"{axis}(_|$)", n)]
        for name in names:
            lag = lag_between(expected, log[name], moving, log.step, LONGEST_S, SLOWEST)
            if lag is None or (axis == "ay" and _on_a_bank(lag)):
                continue
            compared = fast_part(log[name], round(SLOWEST * LONGEST_S / log.step))
            if _useless(lag, motion_in(compared[moving])):
                findings.append(_finding(log, name, axis, lag))
    return findings


def kinematic(log: DriveLog) -> dict[str, Array]:
    """Specific forces that the velocities tell; gravity on a bank that is known moves the car and is not felt."""
    forward, sideways = (specific_force(axis, log.columns, log.segment) for axis in ("ax", "ay"))
    pulled = GRAVITY * np.sin(log["known_bank"]) if "known_bank" in log else 0.0
    return {"ax": forward, "ay": sideways + pulled}


def motion_in(signal: Array) -> float:
    """Share of the variance of a sensor's signal (n,) that is not its own white noise, seen in second differences."""
    return float(np.clip(1.0 - (second_difference_noise(signal) / max(float(signal.std()), 1e-9)) ** 2, 0.0, 1.0))


def _useless(lag: Lag, motion: float) -> bool:
    """Whether a channel does not follow; with so little `motion` in it that none could, nothing is said of it.

    Noise lowers the correlation by the root of the share of the variance that motion has.
    """
    low, high = GAIN_BAND
    if motion < LEAST_MOTION:
        return False
    follows = lag.correlation >= MIN_CORRELATION * np.sqrt(motion)
    return not follows or abs(lag.value) > LATE_S or not low < lag.gain < high


def _on_a_bank(lag: Lag) -> bool:
    return lag.correlation > BANKED_CORRELATION and abs(lag.value) < LATE_S and BANKED_GAIN < lag.gain < 1.0


def _finding(log: DriveLog, name: str, axis: str, lag: Lag) -> LogFinding:
    velocity = "vx" if axis == "ax" else "vy"
    late = "lags" if lag.value > 0 else "leads"
    text = (
        f"{name} is useless as {axis}: it {late} the derivative of {velocity} by {abs(lag.value):.2f} s, with gain"
        f" {lag.gain:.2f} and correlation {lag.correlation:.2f} at best"
    )
    confidence = float(min(1.0, max(abs(lag.value) / LATE_S, 1.0 / max(lag.gain, 0.1)) / 2.0))
    if name != axis:
        return LogFinding(f"useless_{name}", name, text, lag.value, lag.std, "s", confidence, Action.EXCLUDED)

    def repair(log: DriveLog) -> DriveLog:
        return rederived(log, (axis,), f"{axis} as logged is not used: derived from velocities instead")

    return LogFinding(f"useless_{name}", name, text, lag.value, lag.std, "s", confidence, Action.EXCLUDED, repair)


def rederived(log: DriveLog, axes: tuple[str, ...], note: str) -> DriveLog:
    """`log` with the named accelerations derived from the velocities it holds now."""
    from dataclasses import replace

    by_velocities = kinematic(log)
    derived = {**log.derived, **{axis: log.derived.get(axis, "from velocities") for axis in axes}}
    return replace(log.with_columns({axis: by_velocities[axis] for axis in axes}, note), derived=derived)
