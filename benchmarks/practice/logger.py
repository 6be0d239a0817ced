"""What a logger makes of what sensors report: channels that come late, a clock that jumps, a zero that drifts."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hil_gateway.process.arrays import Array

LATE = {"position_lag": ("x", "y"), "speed_lag": ("vx",)}
"""effect -> the channels that are late by its size, s"""


def recorded(s: Mapping[str, float], columns: Mapping[str, Array], t: Array, moment_s: float) -> dict[str, Array]:
    """The channels (n,) as they are written at the times `t`, s; the clock jumps at `moment_s`."""
    out = dict(columns)
    for effect, names in LATE.items():
        out |= {name: np.interp(t - s.get(effect, 0.0), t, out[name]) for name in names}
    out["yaw_rate"] = out["yaw_rate"] + s.get("gyro_drift", 0.0) * np.minimum(t / 400.0, 1.0)
    out["ax"] = out["ax"] + s.get("ax_drift", 0.0) * np.minimum(t / 400.0, 1.0)
    if every := s.get("held_positions", 0.0):
        at = np.maximum(np.searchsorted(t, np.floor(t / every) * every + 1e-9) - 1, 0)
        out |= {name: out[name][at] for name in ("x", "y")}
    out["vx"] = out["vx"] * (1 + s.get("wheel_speed", 0.0) * out["drive"] / 0.05)
    return out | {"t": t + s.get("clock_jump", 0.0) * (t > moment_s)}
