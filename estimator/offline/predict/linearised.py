"""Residual and sensitivity of the measured signals around one set of parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimator.offline.predict.innovations import STATE_ROWS, VY_ROW, YAW_RATE_ROW, Innovations
from estimator.offline.predict.propagate import MOTION, Propagator
from estimator.offline.record.noise import Noise
from estimator.offline.record.record import Record
from hil_gateway.process.arrays import Array


@dataclass(frozen=True)
class Linearised:
    """What a model leaves of the measured signals around one set of parameters.

    Attributes:
        error: (5, windows, blocks) whitened residual of the measured signals.
        sensitivity: (5, p, windows, blocks) of the predictions by the parameters, whitened alike.
        propagator, forces_by: the motion, and the derivatives (2, 3, windows, blocks) of ax, ay by the states.
        inputs: (blocks, windows, 11, 1 + p) of the predictor, see `Innovations`.
    """

    record: Record
    propagator: Propagator
    forces_by: Array
    innovations: Innovations
    inputs: Array
    error: Array
    sensitivity: Array

    @property
    def state_errors(self) -> Array:
        """(blocks, windows, 3) predicted less smoothed vx, vy, yaw rate where each block begins."""
        return self.inputs[:, :, :3, 0]

    def sensitivity_by(self, jacobian: Array) -> Array:
        """(5, k, windows, blocks) by k further parameters, from the predictions' derivatives `jacobian` by them."""
        return _whitened(self.innovations, _effects(self.record, jacobian))

    def error_under(self, noise: Noise) -> tuple[Array, Array]:
        """Residual (5, windows, blocks) as it would be with other noise, and the scale of its whitening (5,)."""
        innovations = Innovations.make(self.record, self.propagator, self.forces_by, noise)
        return np.moveaxis(innovations.run(self.inputs[..., :1].copy())[..., 0], 2, 0), innovations.scale


def linearised(record: Record, values: Array, state_by: Array, jacobian: Array, noise: Noise) -> Linearised:
    """Residual and sensitivity of the measured signals.

    Args:
        record: the windows.
        values, state_by, jacobian: predictions and derivatives as `Predictor.linearise` gives them.
        noise: of the measured signals and of the motion.
    """
    if not _lateral_is_known(record):
        state_by = state_by.copy()
        state_by[[2, 4]] = 0.0
    propagator = Propagator.make(state_by, record.block_step)
    forces_by = state_by[:2]
    innovations = Innovations.make(record, propagator, forces_by, noise)
    inputs = np.concatenate([_errors(record, values), _effects(record, jacobian)], axis=-1)
    out = _whitened(innovations, inputs)
    return Linearised(record, propagator, forces_by, innovations, inputs, out[:, 0], out[:, 1:])


def _whitened(innovations: Innovations, inputs: Array) -> Array:
    """(5, k, windows, blocks) innovations of `inputs` (blocks, windows, 11, k)."""
    return np.moveaxis(innovations.run(inputs), (0, 1, 2, 3), (3, 2, 0, 1))


def _errors(record: Record, values: Array) -> Array:
    """(blocks, windows, 11, 1): defect of the motion, measured less predicted."""
    step, measured = record.block_step, record.measured_blocks
    windows, blocks = record.rows.shape[:2]
    inputs = np.zeros((blocks, windows, 11, 1))
    defect = values[list(MOTION)] * step - np.diff(record.state_edges, axis=2)
    inputs[:, :, 3:6, 0] = defect.transpose(2, 1, 0)
    inputs[:, :, 6:8, 0] = (measured[:2] - values[:2]).transpose(2, 1, 0)
    inputs[:, :, 8:, 0] = (measured[STATE_ROWS] - record.state_means).transpose(2, 1, 0)
    return _without_lateral(record, inputs)


def _effects(record: Record, jacobian: Array) -> Array:
    """(blocks, windows, 11, k): the same less what a unit of each of k parameters adds."""
    windows, blocks = record.rows.shape[:2]
    inputs = np.zeros((blocks, windows, 11, jacobian.shape[1]))
    inputs[:, :, 3:6] = np.moveaxis(jacobian[list(MOTION)] * -record.block_step, (0, 1, 2, 3), (2, 3, 1, 0))
    inputs[:, :, 6:8] = np.moveaxis(jacobian[:2], (0, 1, 2, 3), (2, 3, 1, 0))
    return _without_lateral(record, inputs)


def _without_lateral(record: Record, inputs: Array) -> Array:
    """The same where vy and yaw rate are inputs, as recorded."""
    if not _lateral_is_known(record):
        inputs[:, :, 4:6] = 0.0
    return inputs


def _lateral_is_known(record: Record) -> bool:
    return bool(record.used[YAW_RATE_ROW] or record.used[VY_ROW])
