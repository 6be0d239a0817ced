"""Predicted measurements of a linearised model, step by step from what was measured up to then.

Between two extremes lies how far a model is trusted. Simulated freely over a window (output error) every small missing
force adds up, and the parameters bend until the simulated motion fits instead of the forces. Evaluated at the measured
motion alone (equation error) noise in the states biases the slip angles. The Kalman predictor has both as its limits:
without process noise it simulates, with much of it it follows the measured motion; how much is estimated from the
residuals (prediction error method; Ljung, System Identification, ch. 7.2 and 4.3). The measured motion alone corrects
the states, never the accelerometer: a wrong tyre force would pull them away from what was measured.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimator.offline.predict.compiled_windows import VECTOR, windows_library
from estimator.offline.predict.propagate import Propagator, product
from estimator.offline.record.noise import ResidualNoise
from estimator.offline.record.record import MEASURED, STATE_ROWS, Record
from hil_gateway.process.arrays import Array

YAW_RATE_ROW, VY_ROW = MEASURED.index("yaw_rate"), MEASURED.index("vy")
START_ERRORS = 2.0
"""The state at the start of a window is taken to be the smoothed one within so many of its stated deviations."""
UNKNOWN_START = np.array([1.0, 0.5, 0.1])
"""The same for a state whose sensor is not used: m/s, m/s, rad/s."""
NOT_MEASURED = 1e12
FROM_CHANNELS = [0, 1, 2, 6, 7, 5, 3, 4]
"""Columns of a step for the state error and the channels (ax, ay, d/dt of yaw rate, vx, vy)."""


@dataclass(frozen=True)
class Innovations:
    """Kalman predictor of every window of a record, as one linear map a block.

    Attributes:
        step: (blocks, windows, 8, 11) map of [state error, its change, measured less predicted] of a block to
            [five whitened innovations, state error at the next edge].
        scale: (5,) by which the innovations are longer than white noise alone would make them.
    """

    step: Array
    scale: Array

    @classmethod
    def make(cls, record: Record, propagator: Propagator, noise: ResidualNoise) -> Innovations:
        """Gains of all blocks."""
        gains, weight, scale = _gains(record, propagator, noise)
        return cls(maps(propagator, gains, weight), scale)

    def run(self, inputs: Array) -> Array:
        """(blocks, windows, 5, 1) whitened innovations of `inputs` (blocks, windows, 11, 1).

        The first three rows of the first block are the state error at the start; those of the others are overwritten.
        """
        blocks, windows = inputs.shape[:2]
        out = np.empty((blocks, windows, 5, 1))
        library = windows_library()
        if library is not None:
            library.call("run", blocks, windows, self.step, inputs, out)
            return out
        for b in range(blocks):
            result = self.step[b] @ inputs[b]
            out[b] = result[:, :5]
            if b + 1 < blocks:
                inputs[b + 1, :, :3] = result[:, 5:]
        return out

    def run_columns(self, columns: Array, moved: Array) -> Array:
        """(blocks, windows, 5, c) whitened innovations of derivatives (blocks, windows, 5, c) of the channels.

        `moved` (3,): change of the error of yaw rate, vx, vy over a block for a unit of its channel.
        """
        factor = np.concatenate([np.ones(5), moved])
        library = windows_library()
        if library is None:
            return self._run_columns(columns, factor)
        columns = np.ascontiguousarray(columns)
        out = np.empty_like(columns)
        blocks, windows, _, c = columns.shape
        library.call("run_columns", blocks, windows, c, self.step, np.array(FROM_CHANNELS), factor, columns, out)
        return out

    def _run_columns(self, columns: Array, factor: Array) -> Array:
        blocks, windows, _, c = columns.shape
        step = self.step[..., FROM_CHANNELS] * factor
        out, inputs, result = np.empty_like(columns), np.zeros((windows, 8, c)), np.empty((windows, 8, c))
        for b in range(blocks):
            inputs[:, 3:] = columns[b]
            np.matmul(step[b], inputs, out=result)
            out[b], inputs[:, :3] = result[:, :5], result[:, 5:]
        return out


def residuals(record: Record, propagator: Propagator, noise: ResidualNoise, inputs: Array) -> tuple[Array, Array]:
    """(5, windows, blocks) whitened innovations of `inputs` (blocks, windows, 11, 1), and `Innovations.scale`."""
    gains, weight, scale = _gains(record, propagator, noise)
    blocks, windows = inputs.shape[:2]
    library = windows_library()
    if library is None or windows < VECTOR:
        innovations = Innovations(maps(propagator, gains, weight), scale)
        return np.ascontiguousarray(innovations.run(inputs.copy())[..., 0].transpose(2, 1, 0)), scale
    motion = propagator.mean_decay, propagator.mean_gain, propagator.decay, propagator.forces_by
    out = np.empty((5, windows, blocks))
    library.call("residuals", blocks, windows, *motion, gains, weight, inputs, out)
    return out, scale


def _gains(record: Record, propagator: Propagator, noise: ResidualNoise) -> tuple[Array, Array, Array]:
    """Gains (3, 3 signals, b, w), weights (5, b, w) of the innovations, and `Innovations.scale`."""
    variance = np.where(record.used, noise.deviation**2, NOT_MEASURED)
    walk = (record.used * noise.drift * noise.deviation**2)[STATE_ROWS]
    gains, ratio = riccati(propagator, variance, walk, _start(record, noise))
    scale = np.exp(0.5 * np.mean(np.log(ratio), axis=(1, 2)))
    return gains, scale[:, None, None] / np.sqrt(ratio) * record.used[:, None, None], scale


def riccati(propagator: Propagator, variance: Array, walk: Array, start: Array) -> tuple[Array, Array]:
    """Gain of each motion signal in turn (3, 3 signals, b, w); variance (5, b, w) of the predicted over the noise's.

    `variance` (5,) is the noise's; `walk` (3,) that of a block's random step of the states, `start` (3,) deviation.
    """
    H, A, F = propagator.mean_decay, propagator.decay, propagator.forces_by
    blocks, windows = H.shape[2:]
    library, states = windows_library(), variance[STATE_ROWS]
    if library is None or windows < VECTOR:
        gains, relative, after = _riccati(H, A, states, walk, start)
        felt = product(F, H)
        forces = 1.0 + (product(felt, after) * felt).sum(axis=1) / variance[:2, None, None]
        return gains, np.concatenate([forces, relative[[2, 0, 1]]])
    gains, ratio = np.empty_like(H), np.empty((5, blocks, windows))
    by_row = np.concatenate([variance[:2], states])
    library.call("riccati", blocks, windows, H, A, F, by_row, walk, start, gains, ratio)
    return gains, ratio


def _riccati(H: Array, A: Array, variance: Array, walk: Array, start: Array) -> tuple[Array, Array, Array]:
    """Gains, innovation variances (3, b, w) over the noise's, covariances (3, 3, b, w)."""
    blocks, windows = H.shape[2:]
    gains, relative, after = np.empty_like(H), np.empty((3, blocks, windows)), np.empty_like(H)
    P = np.broadcast_to(np.diag(start**2)[:, :, None], (3, 3, windows))
    for b in range(blocks):
        for i in range(3):
            row = H[i, :, b]
            seen = (P * row).sum(axis=1)
            innovation = (seen * row).sum(axis=0) + variance[i]
            gain = seen / innovation
            gains[:, i, b], relative[i, b] = gain, innovation / variance[i]
            P = P - gain[:, None] * seen
        after[:, :, b] = P
        step = A[:, :, b]
        moved = np.einsum("ijw,ljw->ilw", np.einsum("ijw,jkw->ikw", step, P), step)
        P = moved + np.diag(walk)[:, :, None]
    return gains, relative, after


def _start(record: Record, noise: ResidualNoise) -> Array:
    used = record.used[STATE_ROWS]
    worse = (noise.deviation / record.block_noise)[STATE_ROWS]
    start = np.where(used, START_ERRORS * record.state_error * worse, UNKNOWN_START)
    if not used[1:].any():  # then these states are inputs, as recorded
        start[1:] = 0.0
    return start


def maps(propagator: Propagator, gains: Array, weight: Array) -> Array:
    """`Innovations.step` from the motion, the gains and the weights (5, b, w).

    With the residual r = m - H e - G g of the motion (m: measured less predicted, e: state error, g: its change over
    the block) the mean error is H e + G g + H K r and the next one A e + H g + A K r.
    """
    H, G, A, F = propagator.mean_decay, propagator.mean_gain, propagator.decay, propagator.forces_by
    blocks, windows = H.shape[2:]
    library = windows_library()
    if library is None or windows < VECTOR:
        return _maps((H, G, A), F, gains, weight)
    out = np.empty((blocks, windows, 8, 11))
    library.call("maps", blocks, windows, H, G, A, F, gains, weight, out)
    return out


def _maps(motion: tuple[Array, Array, Array], F: Array, gains: Array, weight: Array) -> Array:
    H, G, A = motion
    K, T = _joint(H, gains)
    AK = product(A, K)
    corrected = product(F, product(H, K))
    felt = F - corrected
    step = np.zeros((8, 11, *H.shape[2:]))
    step[:2, :3], step[:2, 3:6], step[:2, 8:] = -product(felt, H), -product(felt, G), -corrected
    step[0, 6], step[1, 7] = 1.0, 1.0
    by_signal = np.concatenate([-product(T, H), -product(T, G), T], axis=1)
    step[[3, 4, 2], :6], step[[3, 4, 2], 8:] = by_signal[:, :6], by_signal[:, 6:]
    step[:5] *= weight[:, None]
    step[5:, :3], step[5:, 3:6], step[5:, 8:] = A - product(AK, H), H - product(AK, G), AK
    return np.ascontiguousarray(step.transpose(2, 3, 0, 1))


def _joint(H: Array, gains: Array) -> tuple[Array, Array]:
    """Gain (3, 3, b, w) by the three residuals together, and the unit triangular map that makes them independent."""
    L = product(H, gains)
    T = np.broadcast_to(np.eye(3)[:, :, None, None], L.shape).copy()
    T[1, 0], T[2, 1] = -L[1, 0], -L[2, 1]
    T[2, 0] = L[2, 1] * L[1, 0] - L[2, 0]
    return product(gains, T), T
