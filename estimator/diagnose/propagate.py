"""From predicted derivatives to predicted measurements: the model run over each window from a free initial state.

The model is linearised about the smoothed trajectory x(t): the simulated one is x + e with
de/dt = A e + f(x, u) - dx/dt, solved block by block with the matrix exponential. Noise in the states then does
not bias the slip angles, because the simulated trajectory has none (output error, Ljung, System Identification,
ch. 3). The same recursion carries every sensitivity; the initial state of each window is eliminated by
projection (Golub & Pereyra, variable projection).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.diagnose.record import Record

Array = NDArray[np.float64]

ORDER = 14
"""Terms of the exponential series; blocks are short enough that |A| dt stays below about 3."""
MOTION = (3, 4, 2)
"""Channels that are the derivatives of vx, vy, yaw_rate."""
STATE_ROWS = (3, 4, 2)
"""Measured rows (see `record.MEASURED`) of vx, vy, yaw_rate."""


@dataclass(frozen=True)
class Propagator:
    """The linearised model of one record at one set of parameters.

    Attributes:
        state_by: (5, 3, windows, blocks) derivative of the channels by vx, vy, yaw_rate.
        decay, gain: (windows, blocks, 3, 3): e at the next edge is decay e + gain g, with g the defect.
        mean_decay, mean_gain: the same for the mean over the block.
    """

    record: Record
    state_by: Array
    decay: Array
    gain: Array
    mean_decay: Array
    mean_gain: Array

    @classmethod
    def make(cls, record: Record, state_by: Array) -> Propagator:
        """Exponential series of every block."""
        step = record.block_step
        a = np.moveaxis(state_by[list(MOTION)], (0, 1), (2, 3)) * step
        identity = np.broadcast_to(np.eye(3), a.shape)
        power, decay, first, second = identity.copy(), identity.copy(), identity.copy(), identity / 2.0
        factorial = 1.0
        for j in range(1, ORDER):
            power = power @ a
            factorial *= j
            decay = decay + power / factorial
            first = first + power / (factorial * (j + 1))
            second = second + power / (factorial * (j + 1) * (j + 2))
        return cls(record, state_by, decay, first, first, second)

    def run(self, change: Array, initial: Array | None = None) -> Array:
        """Block means of e, (3, k, windows, blocks), from the change of state over each block, of the same shape.

        `initial` (3, k, windows) is e at the first edge; default 0.
        """
        _, k, windows, blocks = change.shape
        e = np.zeros((windows, 3, k)) if initial is None else np.moveaxis(initial, (0, 1, 2), (1, 2, 0)).copy()
        defect = np.ascontiguousarray(np.moveaxis(change, (0, 1, 2, 3), (2, 3, 1, 0)))
        out = np.empty((blocks, windows, 3, k))
        for b in range(blocks):
            out[b] = self.mean_decay[:, b] @ e + self.mean_gain[:, b] @ defect[b]
            e = self.decay[:, b] @ e + self.gain[:, b] @ defect[b]
        return np.moveaxis(out, (0, 1, 2, 3), (3, 2, 0, 1))

    def outputs(self, forces: Array, states: Array) -> Array:
        """(5, k, windows, blocks) measured signals from changes of ax, ay (2, k, ...) and of states e (3, k, ...)."""
        out = np.empty((5, *states.shape[1:]))
        out[:2] = forces + np.einsum("cswb,skwb->ckwb", self.state_by[:2], states)
        for row, state in zip(STATE_ROWS, states, strict=True):
            out[row] = state
        return out

    def initial_columns(self) -> Array:
        """(5, 3, windows, blocks) response of the measured signals to each initial state."""
        windows, blocks = self.record.rows.shape[:2]
        start = np.broadcast_to(np.eye(3)[:, :, None], (3, 3, windows))
        states = self.run(np.zeros((3, 3, windows, blocks)), start)
        return self.outputs(np.zeros((2, 3, windows, blocks)), states)


def residual_and_sensitivity(
    record: Record, values: Array, state_by: Array, jacobian: Array, deviation: Array
) -> tuple[Array, Array]:
    """Residual (5, windows, blocks) of the measured signals and their sensitivity (5, p, windows, blocks).

    Args:
        values, state_by, jacobian: predictions and derivatives as `Predictor.linearise` gives them.
        deviation: (5,) standard deviation by which channels are weighed when initial states are eliminated.
    """
    propagator = Propagator.make(record, state_by)
    means, edges = record.states()
    step = record.block_step
    defect = values[list(MOTION)] * step - np.diff(edges, axis=2)
    inputs = np.concatenate([defect[:, None], jacobian[list(MOTION)] * step], axis=1)
    states = propagator.run(inputs)
    forces = np.concatenate([values[:2][:, None], jacobian[:2]], axis=1)
    columns = propagator.outputs(forces, states)
    measured = record.measured_blocks()
    columns[:, 0] = -columns[:, 0]
    columns[:2, 0] += measured[:2]
    for row, mean in zip(STATE_ROWS, means, strict=True):
        columns[row, 0] += measured[row] - mean
    columns = _without_initial(columns, propagator.initial_columns(), deviation)
    return columns[:, 0], columns[:, 1:]


def _without_initial(columns: Array, initial: Array, deviation: Array) -> Array:
    """Project the responses (5, 3, ...) to the initial states out of every column (5, k, ...), window by window."""
    weighted = initial / deviation[:, None, None, None]
    windows = columns.shape[2]
    x = np.moveaxis(weighted, (0, 1, 2, 3), (1, 3, 0, 2)).reshape(windows, -1, 3)
    y = np.moveaxis(columns / deviation[:, None, None, None], (0, 1, 2, 3), (1, 3, 0, 2)).reshape(
        windows, x.shape[1], -1
    )
    xt = x.transpose(0, 2, 1)
    y = y - x @ np.linalg.solve(xt @ x, xt @ y)
    shaped = y.reshape(windows, 5, columns.shape[3], -1)
    return np.moveaxis(shaped, (0, 1, 2, 3), (2, 0, 3, 1)) * deviation[:, None, None, None]
