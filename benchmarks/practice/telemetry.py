"""What a car's own logger makes of a drive: late, displaced and slow channels, as in measured runs of the AV-21.

25 Hz with a short step every second that the time stamps do not know, yaw rate 0.3 s late, vy turned by 0.8 deg, biased
and taken behind the centre of gravity, no accelerations but one of ax that is late and attenuated, heading interpolated
while wrapped, roll of the body against the horizon in degrees.
"""

from __future__ import annotations

import numpy as np

from hil_gateway.process.arrays import Array, Ints

from .drive import Drive

EVERY, SHORT_EVERY = 4, 25
"""rows of the drive (100 Hz) a sample; every so many samples there is one row less"""
STEP = 0.04
"""s, by the time stamps"""
YAW_RATE_LATE, AX_LATE, AX_GAIN = 0.30, 1.1, 0.45
"""s, s and 1"""
VY_ANGLE, VY_BIAS, VY_AHEAD = np.radians(0.8), 0.08, -0.4
"""rad, m/s, m"""
AY_AHEAD = 0.5
"""m; of the accelerometer, where there is one"""
ROLL_ZERO, ROLL_BY_AY = np.radians(0.9), np.radians(0.1)
"""rad, and rad per m/s2 that the body leans out of a bend on its springs"""
ROLL_NOISE, AX_NOISE = np.radians(0.15), 0.1
"""rad, m/s2; all other channels have the noise of the drive"""


def telemetry(drive: Drive, seed: int, *, ay: bool = False, roll_sign: float = 1.0) -> dict[str, Array]:
    """Columns of the log of a drive that has its `bank`, with `ay` at its sensor or without.

    Args:
        drive: at 100 Hz, with the bank under the car as a column.
        seed: of the noise that the logger adds.
        ay: whether there is a lateral accelerometer.
        roll_sign: 1 for left side up positive, -1 for the other convention.
    """
    rng = np.random.default_rng([seed, 99])
    c, rows = drive.columns, _rows(len(drive.columns["t"]))
    t, rate = c["t"], c["yaw_rate"]
    ax = np.convolve(c["ax"], np.ones(50) / 50, "same")
    roll = c["bank"] + ROLL_ZERO + ROLL_BY_AY * np.convolve(c["ay"], np.ones(20) / 20, "same")
    values = {
        "x": c["x"], "y": c["y"], "yaw": (c["yaw"] + np.pi) % (2 * np.pi) - np.pi, "vx": c["vx"],
        "vy": c["vy"] + VY_ANGLE * c["vx"] + VY_BIAS + VY_AHEAD * rate,
        "yaw_rate": np.interp(t - YAW_RATE_LATE, t, rate),
        **{name: c[name] for name in ("steer", "throttle", "brake")},
        **{name: c[name] for name in c if name.startswith("wheel_speed")},
        "ax_logged": AX_GAIN * np.interp(t - AX_LATE, t, ax) + AX_NOISE * rng.normal(size=len(t)),
        "roll_logged": np.degrees(roll_sign * (roll + ROLL_NOISE * rng.normal(size=len(t)))),
    }  # fmt: skip
    if ay:
        turning = np.gradient(np.convolve(rate, np.ones(9) / 9, "same"), t)
        values["ay"] = c["ay"] + AY_AHEAD * turning
    return {"t": STEP * np.arange(len(rows))} | {name: column[rows] for name, column in values.items()}


def _rows(count: int) -> Ints:
    """Rows of the drive that are logged."""
    steps = np.full(count // EVERY + 1, EVERY)
    steps[::SHORT_EVERY] -= 1
    rows = np.cumsum(steps) - steps[0]
    return np.asarray(rows[rows < count], np.int64)
