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

from estimator.offline.predict.propagate import Propagator
from estimator.offline.record.noise import Noise
from estimator.offline.record.record import Record
from hil_gateway.process.arrays import Array

YAW_RATE_ROW, VY_ROW = 2, 4
STATE_ROWS = [3, VY_ROW, YAW_RATE_ROW]
"""Measured rows (see `record.MEASURED`) of vx, vy, yaw_rate."""
START_ERRORS = 2.0
"""The state at the start of a window is taken to be the smoothed one within so many of its stated deviations."""
UNKNOWN_START = np.array([1.0, 0.5, 0.1])
"""The same for a state whose sensor is not used: m/s, m/s, rad/s."""
NOT_MEASURED = 1e12


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
    def make(cls, record: Record, propagator: Propagator, forces_by: Array, noise: Noise) -> Innovations:
        """Gains of all blocks; `forces_by` (2, 3, windows, blocks) are the derivatives of ax, ay by the states."""
        H, G, A, gain = (
            np.moveaxis(m, 1, 0)
            for m in (propagator.mean_decay, propagator.mean_gain, propagator.decay, propagator.gain)
        )
        F = np.moveaxis(forces_by, (0, 1, 2, 3), (2, 3, 1, 0))
        variance = np.where(record.used, noise.deviation**2, NOT_MEASURED)
        gains, relative, after = _riccati(record, H, A, variance[STATE_ROWS], noise)
        K, T = _joint(H, gains)
        felt = F @ H
        relative_forces = 1.0 + np.einsum("bwij,bwjk,bwik->bwi", felt, after, felt) / variance[:2]
        ratio = np.concatenate([relative_forces, relative[..., [2, 0, 1]]], axis=-1)
        scale = np.exp(0.5 * np.mean(np.log(ratio), axis=(0, 1)))
        weight = scale / np.sqrt(ratio) * record.used
        return cls(_maps((H, G, A, gain), F, (K, T), weight), scale)

    def run(self, inputs: Array) -> Array:
        """(blocks, windows, 5, k) whitened innovations of `inputs` (blocks, windows, 11, k).

        The first three rows of the first block are the state error at the start; those of the others are overwritten.
        """
        blocks, windows, _, k = inputs.shape
        out = np.empty((blocks, windows, 5, k))
        for b in range(blocks):
            result = self.step[b] @ inputs[b]
            out[b] = result[:, :5]
            if b + 1 < blocks:
                inputs[b + 1, :, :3] = result[:, 5:]
        return out


def _riccati(record: Record, H: Array, A: Array, variance: Array, noise: Noise) -> tuple[Array, Array, Array]:
    """Gain of each motion signal in turn (b, w, 3 signals, 3), its innovation variance over the noise's, covariance."""
    blocks, windows = H.shape[:2]
    gains, relative, after = np.empty((blocks, windows, 3, 3)), np.empty((blocks, windows, 3)), np.empty_like(H)
    walk = np.diag((record.used * noise.drift * noise.deviation**2)[STATE_ROWS])
    P = np.broadcast_to(np.diag(_start(record, noise) ** 2), (windows, 3, 3)).copy()
    for b in range(blocks):
        for i in range(3):
            row = H[b, :, i]
            seen = np.einsum("wij,wj->wi", P, row)
            innovation = np.einsum("wi,wi->w", row, seen) + variance[i]
            gains[b, :, i], relative[b, :, i] = seen / innovation[:, None], innovation / variance[i]
            P = P - gains[b, :, i, :, None] * seen[:, None]
        after[b] = P
        P = A[b] @ P @ A[b].swapaxes(1, 2) + walk
    return gains, relative, after


def _start(record: Record, noise: Noise) -> Array:
    used = record.used[STATE_ROWS]
    worse = (noise.deviation / record.block_noise)[STATE_ROWS]
    start = np.where(used, START_ERRORS * record.state_error * worse, UNKNOWN_START)
    if not used[1:].any():  # then these states are inputs, as recorded
        start[1:] = 0.0
    return start


def _joint(H: Array, gains: Array) -> tuple[Array, Array]:
    """Gain (b, w, 3, 3) by the three residuals together, and the unit triangular map that makes them independent."""
    K = gains.swapaxes(2, 3)
    L = H @ K
    T = np.broadcast_to(np.eye(3), L.shape).copy()
    T[..., 1, 0], T[..., 2, 1] = -L[..., 1, 0], -L[..., 2, 1]
    T[..., 2, 0] = L[..., 2, 1] * L[..., 1, 0] - L[..., 2, 0]
    return K @ T, T


def _maps(block: tuple[Array, Array, Array, Array], F: Array, joint: tuple[Array, Array], weight: Array) -> Array:
    """`Innovations.step` from the block's exponentials, force derivatives, gains and weights."""
    (H, G, A, gain), (K, T) = block, joint
    shape, identity = H.shape[:2], np.broadcast_to(np.eye(3), H.shape)
    # maps from [error (3), change (3), measured less predicted (ax, ay, vx, vy, yaw rate)]
    residual = np.zeros((*shape, 3, 11))
    residual[..., :3], residual[..., 3:6], residual[..., 8:] = -H, -G, identity
    predicted, following = np.zeros_like(residual), np.zeros_like(residual)
    predicted[..., :3], predicted[..., 3:6] = H, G
    following[..., :3], following[..., 3:6] = A, gain
    correction = K @ residual
    mean = predicted + H @ correction
    step = np.empty((*shape, 8, 11))
    step[..., :2, :] = -F @ mean
    step[..., 0, 6] += 1.0
    step[..., 1, 7] += 1.0
    step[..., [3, 4, 2], :] = T @ residual
    step[..., :5, :] *= weight[..., None]
    step[..., 5:, :] = following + A @ correction
    return step
