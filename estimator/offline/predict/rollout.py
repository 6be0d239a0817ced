"""Open-loop prediction over windows: simulate from a known state, compare with what was measured after a run-in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.drive_log.table import DriveLog
from estimator.model.columns import ModelColumns
from estimator.model.effect import VY_SENSOR
from estimator.model.single_track import SIGNALS
from estimator.offline.predict.simulate import OUTPUTS, Simulator
from estimator.offline.record.prepare import Samples
from estimator.offline.record.windows import STATE_ROWS, cut
from hil_gateway.process.arrays import Array

RUN_IN_S = 0.5
"""Start of each window that is simulated but not scored: the state it starts from is known as well as its sensors."""


@dataclass(frozen=True)
class Rollout:
    """Simulated and measured `OUTPUTS` (4, n) at `index` (n,) of the samples; `rmse` per output."""

    simulated: Array
    measured: Array
    index: NDArray[np.int64]

    @property
    def rmse(self) -> dict[str, float]:
        """Root mean square of measured minus simulated."""
        error = np.sqrt(np.mean((self.measured - self.simulated) ** 2, axis=1))
        return dict(zip(OUTPUTS, error.tolist(), strict=True))


def roll_out(columns: ModelColumns, log: DriveLog, samples: Samples, theta: Array, window_s: float) -> Rollout:
    """Simulate `samples` in windows of `window_s` at `theta`; a window that diverges counts with what was measured."""
    windows = cut(log, samples, window_s + RUN_IN_S)
    start = windows.inputs[list(STATE_ROWS), 0]
    start[0] -= _sensor_offset(columns, theta, windows.inputs[SIGNALS.index("vx"), 0], start[1])
    outputs = Simulator(columns).run(windows, start, theta, sensitivities=False).outputs
    scored = windows.weight > 0
    scored[: round(RUN_IN_S / windows.step)] = False
    simulated = np.where(np.isfinite(outputs), outputs, 0.0)
    return Rollout(simulated[:, scored], windows.measured[:, scored], windows.index[scored])


def _sensor_offset(columns: ModelColumns, theta: Array, vx: Array, yaw_rate: Array) -> Array | float:
    values = dict(zip((p.name for p in columns.parameters), theta.tolist(), strict=True))
    if f"{VY_SENSOR}.x" not in values:
        return 0.0
    x, angle, bias = (values[f"{VY_SENSOR}.{name}"] for name in ("x", "angle", "bias"))
    return np.asarray(x * yaw_rate + angle * vx + bias)
