"""The measurement model at single points, for tests that look at h and its Jacobians."""

from __future__ import annotations

import numpy as np

from estimator.model.measurement import MeasurementKind, measurement_function
from estimator.model.single_track import SingleTrack
from hil_gateway.process.arrays import Array


class MeasurementEvaluation:
    """h and its Jacobians for one model."""

    def __init__(self, model: SingleTrack, kind: MeasurementKind) -> None:
        self._function = measurement_function(model, kind)

    def __call__(self, signals: Array, aux: Array, theta: Array) -> tuple[Array, Array, Array]:
        """h (m,), dh/dtheta (m, n), dh/dsignals (m, 5)."""
        h, h_theta, h_signals = (np.array(a) for a in self._function(signals, aux, theta, np.zeros((0, 1))))
        return h[:, 0], h_theta, h_signals
