"""What a fit says is still wrong with its log: whether it matters, and the fit for the log without it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from estimator.model.effect import VY_SENSOR
from estimator.offline.fit.equation_error import EquationErrorFit
from estimator.offline.health.finding import LEAST_ERRORS, LogFinding
from estimator.offline.health.lateral_velocity import POSITION_VY
from estimator.offline.health.offsets import OFFSET_YAW_RATE
from estimator.offline.health.steering import LAG_STEER
from estimator.offline.predict.nuisance import STEER_TIMING, YAW_RATE_TIMING

ESTIMATED = {
    LAG_STEER: f"{STEER_TIMING}.tau", OFFSET_YAW_RATE: f"{YAW_RATE_TIMING}.tau", POSITION_VY: f"{VY_SENSOR}.x",
}  # fmt: skip
"""Finding -> what the fit estimates of it."""


def without(fit: EquationErrorFit, found: Iterable[LogFinding]) -> EquationErrorFit:
    """`fit` for the log that what was `found` is taken out of."""
    values = fit.values | {ESTIMATED[finding.name]: 0.0 for finding in found}
    return replace(fit, theta=np.array([values[name] for name in fit.names]))


def moves_ay(fit: EquationErrorFit, speed: float) -> bool:
    """Whether d/dt vy + vx yaw_rate is off beyond error at `speed`, m/s: by the sensor's place less the way of the lag.

    A sensor further ahead looks like a yaw rate that is later; of that the derived ay shows nothing.
    """
    by = {ESTIMATED[POSITION_VY]: 1.0, ESTIMATED[OFFSET_YAW_RATE]: -speed}
    row = np.array([by.get(name, 0.0) for name in fit.names])
    return bool(abs(row @ fit.theta) > LEAST_ERRORS * np.sqrt(row @ fit.covariance @ row))
