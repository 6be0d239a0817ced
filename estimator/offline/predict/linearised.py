"""Residual and sensitivity of the measured signals around one set of parameters."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from estimator.offline.predict.innovations import VY_ROW, YAW_RATE_ROW, Innovations, residuals
from estimator.offline.predict.propagate import Propagator
from estimator.offline.record.noise import ResidualNoise
from estimator.offline.record.record import STATE_ROWS, Record
from estimator.offline.record.window_columns import WindowColumns
from hil_gateway.process.arrays import Array


@dataclass(frozen=True)
class Linearised:
    """What a model leaves of the measured signals around one set of parameters.

    Attributes:
        propagator: the motion, and what ax and ay feel of it.
        inputs: (blocks, windows, 11, 1) of the predictor, see `Innovations`.
        error: (5, windows, blocks) whitened residual of the measured signals.
    """

    record: Record
    propagator: Propagator
    innovations: Innovations
    inputs: Array
    error: Array

    @property
    def state_errors(self) -> Array:
        """(blocks, windows, 3) predicted less smoothed vx, vy, yaw rate where each block begins."""
        return self.inputs[:, :, :3, 0]

    def sensitivity(self, columns: WindowColumns) -> WindowColumns:
        """Of the predictions by parameters, whitened like the residual, from the `columns` of the model."""
        known = _lateral_is_known(self.record)
        felt = np.array([known, True, known]) * -self.record.block_step
        return replace(columns, values=self.innovations.run_columns(columns.values, felt))

    def error_under(self, noise: ResidualNoise) -> tuple[Array, Array]:
        """Residual (5, windows, blocks) as it would be with other noise, and the scale of its whitening (5,)."""
        return residuals(self.record, self.propagator, noise, self.inputs)

    def under(self, noise: ResidualNoise) -> Linearised:
        """The same with other noise."""
        innovations = Innovations.make(self.record, self.propagator, noise)
        inputs = self.inputs.copy()
        error = _residual(innovations, inputs)
        return replace(self, innovations=innovations, inputs=inputs, error=error)


def linearised(record: Record, values: Array, state_by: Array, noise: ResidualNoise) -> Linearised:
    """Residual of the measured signals, and what their sensitivities are whitened with.

    Args:
        record: the windows.
        values, state_by: predictions and their derivatives by the states, as `Predictor.linearise` gives them.
        noise: of the measured signals and of the motion.
    """
    if not _lateral_is_known(record):
        state_by = state_by.copy()
        state_by[[2, 4]] = 0.0
    propagator = Propagator.make(state_by, record.block_step)
    innovations = Innovations.make(record, propagator, noise)
    inputs = _errors(record, values)
    error = _residual(innovations, inputs)
    return Linearised(record, propagator, innovations, inputs, error)


def _residual(innovations: Innovations, inputs: Array) -> Array:
    """(5, windows, blocks) innovations of `inputs` (blocks, windows, 11, 1)."""
    return np.ascontiguousarray(innovations.run(inputs)[..., 0].transpose(2, 1, 0))


def _errors(record: Record, values: Array) -> Array:
    """(blocks, windows, 11, 1): defect of the motion, measured less predicted."""
    step, measured = record.block_step, record.measured_blocks
    windows, blocks = record.rows.shape[:2]
    inputs = np.zeros((blocks, windows, 11, 1))
    defect = values[STATE_ROWS] * step - np.diff(record.state_edges, axis=2)
    inputs[:, :, 3:6, 0] = defect.transpose(2, 1, 0)
    inputs[:, :, 6:8, 0] = (measured[:2] - values[:2]).transpose(2, 1, 0)
    inputs[:, :, 8:, 0] = (measured[STATE_ROWS] - record.state_means).transpose(2, 1, 0)
    if not _lateral_is_known(record):  # vy and yaw rate are inputs, as recorded
        inputs[:, :, 4:6] = 0.0
    return inputs


def _lateral_is_known(record: Record) -> bool:
    return bool(record.used[YAW_RATE_ROW] or record.used[VY_ROW])
