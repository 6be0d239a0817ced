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

from estimator.diagnose.noise import Noise
from estimator.diagnose.record import Record, Trajectory

Array = NDArray[np.float64]

ORDER, DOUBLINGS = 8, 3
"""Terms of the exponential series of an eighth of a block: |A| dt may be 8 at slow speed with stiff tyres."""
MOTION = (3, 4, 2)
"""Channels that are the derivatives of vx, vy, yaw_rate."""
YAW_RATE_ROW, VY_ROW = 2, 4
STATE_ROWS = (3, VY_ROW, YAW_RATE_ROW)
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
        """Exponential series of every block, of a fraction of it first and then doubled (scaling and squaring)."""
        step = record.block_step
        a = np.moveaxis(state_by[list(MOTION)], (0, 1), (2, 3)) * (step / 2**DOUBLINGS)
        identity = np.eye(3)
        power, decay, first, second = (np.broadcast_to(identity / d, a.shape).copy() for d in (1.0, 1.0, 1.0, 2.0))
        factorial = 1.0
        for j in range(1, ORDER):
            power = power @ a
            factorial *= j
            decay += power / factorial
            first += power / (factorial * (j + 1))
            second += power / (factorial * (j + 1) * (j + 2))
        for _ in range(DOUBLINGS):
            second = (first @ first + 2.0 * second) / 4.0
            first = first @ (decay + identity) / 2.0
            decay = decay @ decay
        return cls(record, state_by, decay, first, first, second)

    def run(self, change: Array, initial: Array | None = None) -> tuple[Array, Array]:
        """Block means (3, k, windows, blocks) and values at the edges (3, k, windows, blocks + 1) of e.

        `change` is that of the state over each block, of the shape of the means; `initial` (3, k, windows) is e at
        the first edge, default 0.
        """
        _, k, windows, blocks = change.shape
        e = np.zeros((windows, 3, k)) if initial is None else np.moveaxis(initial, (0, 1, 2), (1, 2, 0)).copy()
        defect = np.ascontiguousarray(np.moveaxis(change, (0, 1, 2, 3), (2, 3, 1, 0)))
        means, edges = np.empty((blocks, windows, 3, k)), np.empty((blocks + 1, windows, 3, k))
        edges[0] = e
        for b in range(blocks):
            means[b] = self.mean_decay[:, b] @ e + self.mean_gain[:, b] @ defect[b]
            e = self.decay[:, b] @ e + self.gain[:, b] @ defect[b]
            edges[b + 1] = e
        return np.moveaxis(means, (0, 1, 2, 3), (3, 2, 0, 1)), np.moveaxis(edges, (0, 1, 2, 3), (3, 2, 0, 1))

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
        states, _ = self.run(np.zeros((3, 3, windows, blocks)), start)
        return self.outputs(np.zeros((2, 3, windows, blocks)), states)


@dataclass(frozen=True)
class Linearised:
    """What a model leaves of the measured signals around one set of parameters, the initial states eliminated.

    Attributes:
        error: (5, windows, blocks) residual of the measured signals, whitened.
        sensitivity: (5, p, windows, blocks) of the predictions by the parameters.
        change: (3, 1 + p, windows, blocks) defect and its derivatives, per block.
        initial: (3, 1 + p, windows) best initial state, and how it falls with each parameter.
    """

    propagator: Propagator
    error: Array
    sensitivity: Array
    change: Array
    initial: Array

    def simulated(self, step: Array) -> Trajectory:
        """The states the model runs through after a `step` (p,) of the parameters."""
        change = self.change[:, :1] + np.einsum("skwb,k->swb", self.change[:, 1:], step)[:, None]
        initial = self.initial[:, :1] - np.einsum("skw,k->sw", self.initial[:, 1:], step)[:, None]
        means, edges = (e[:, 0] for e in self.propagator.run(change, initial))
        about = self.propagator.record.states()
        reach = np.max(np.abs(edges) / FURTHEST[:, None, None], axis=(0, 2))
        share = 1.0 / np.maximum(reach, 1.0)[:, None]
        return Trajectory(about.means + share * means, about.edges + share * edges)


FURTHEST = np.array([2.0, 1.0, 0.2])
"""Most that vx, vy (m/s) and yaw rate (rad/s) are moved at once: beyond, the linearisation means nothing."""


def linearised(record: Record, values: Array, state_by: Array, jacobian: Array, noise: Noise) -> Linearised:
    """Residual and sensitivity of the measured signals.

    Args:
        record: the windows, with the states they are linearised about.
        values, state_by, jacobian: predictions and derivatives as `Predictor.linearise` gives them.
        noise: by which channels are whitened, and weighed when initial states are eliminated.
    """
    lateral_is_known = record.used[YAW_RATE_ROW] or record.used[VY_ROW]
    if not lateral_is_known:  # then these states are inputs, as recorded
        state_by = state_by.copy()
        state_by[[2, 4]] = 0.0
    propagator = Propagator.make(record, state_by)
    about = record.states()
    step = record.block_step
    defect = values[list(MOTION)] * step - np.diff(about.edges, axis=2)
    change = np.concatenate([defect[:, None], jacobian[list(MOTION)] * step], axis=1)
    if not lateral_is_known:
        change[1:] = 0.0
    states, _ = propagator.run(change)
    forces = np.concatenate([values[:2][:, None], jacobian[:2]], axis=1)
    columns = propagator.outputs(forces, states)
    measured = record.measured_blocks()
    columns[:, 0] = -columns[:, 0]
    columns[:2, 0] += measured[:2]
    for row, mean in zip(STATE_ROWS, about.means, strict=True):
        columns[row, 0] += measured[row] - mean
    initial_columns = propagator.initial_columns()
    if not lateral_is_known:
        initial_columns[:, 1:] = 0.0
    columns[~record.used] = initial_columns[~record.used] = 0.0
    columns, initial = _without_initial(noise.whiten(columns), noise.whiten(initial_columns), noise.deviation)
    return Linearised(propagator, columns[:, 0], columns[:, 1:], change, initial)


RIDGE = 1e-13
"""Relative: keeps the solve defined where a poor model has blown up."""


def _without_initial(columns: Array, initial: Array, deviation: Array) -> tuple[Array, Array]:
    """Project the responses (5, 3, ...) to the initial states out of every column (5, k, ...), window by window.

    Returns:
        what is left of the columns, and the initial states (3, k, windows) that take the rest away.
    """
    weighted = initial / deviation[:, None, None, None]
    windows = columns.shape[2]
    x = np.moveaxis(weighted, (0, 1, 2, 3), (1, 3, 0, 2)).reshape(windows, -1, 3)
    y = np.moveaxis(columns / deviation[:, None, None, None], (0, 1, 2, 3), (1, 3, 0, 2)).reshape(
        windows, x.shape[1], -1
    )
    xt = x.transpose(0, 2, 1)
    square = xt @ x
    square = square + RIDGE * np.trace(square, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    best = np.linalg.solve(square, xt @ y)
    y = y - x @ best
    shaped = y.reshape(windows, 5, columns.shape[3], -1)
    left: Array = np.moveaxis(shaped, (0, 1, 2, 3), (2, 0, 3, 1)) * deviation[:, None, None, None]
    return left, np.moveaxis(best, (0, 1, 2), (2, 0, 1))
