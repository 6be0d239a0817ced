"""A drive on an open circle."""

from __future__ import annotations

import numpy as np

from estimator.drive_log.table import DriveLog


def circles() -> DriveLog:
    """One circle driven faster and faster, its small accelerations drowned in noise."""
    rng = np.random.default_rng(5)
    t = np.arange(0.0, 400.0, 0.02)
    vx = 15.0 + 12.0 * t / t[-1] + 0.3 * np.sin(0.4 * t)
    turning = vx / 70.0
    columns = {
        "t": t, "yaw_rate": turning, "vx": vx, "vy": 1.25 * turning - vx * (0.001 * vx * turning) ** 1.2,
        "steer": np.full(len(t), 0.04), "drive": np.full(len(t), 0.004), "ax": np.gradient(vx, t),
        "ay": vx * turning,
    }  # fmt: skip
    spread = {"yaw_rate": 0.003, "vx": 0.03, "vy": 0.03, "steer": 0.002, "drive": 0.001, "ax": 0.2, "ay": 0.2}
    noisy = {n: c + spread.get(n, 0.0) * rng.standard_normal(len(t)) for n, c in columns.items()}
    return DriveLog(noisy, np.zeros(len(t), np.int64))
