"""What is left of each measured channel when a model is fitted: white noise, and in the motion signals also drift.

A missing force acts on the acceleration, so in a velocity its trace is no white noise but a random walk. Weighed as
white noise, a few windows with a long push would decide about everything; whitened, every acceleration counts once
(generalised least squares; Ljung, System Identification, ch. 7.5). Without model error the drift is zero.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MOTION_ROWS = (2, 3, 4)
"""Measured rows that are integrals: yaw rate, vx, vy."""
DRIFTS = (0.0, *(float(d) for d in np.geomspace(1e-3, 1e2, 11)))
"""Variance of the random walk's step per block, relative to that of the white noise, that are tried."""


@dataclass(frozen=True)
class Noise:
    """Noise of the measured channels.

    Attributes:
        deviation: (5,) standard deviation by which channels are weighed.
        drift: (5,) variance of the random walk's step per block, relative to the white noise; 0: white.
    """

    deviation: Array
    drift: Array

    @classmethod
    def white(cls, deviation: Array) -> Noise:
        """White noise in every channel."""
        return cls(deviation, np.zeros(len(deviation)))

    def whiten(self, columns: Array) -> Array:
        """(5, k, windows, blocks) columns made white over the blocks, in place; the determinant of the map is 1."""
        for channel in np.flatnonzero(self.drift):
            columns[channel] = columns[channel] @ whitening(float(self.drift[channel]), columns.shape[-1]).T
        return columns

    def close_to(self, other: Noise, tolerance: float) -> bool:
        """Whether the deviations agree within a relative `tolerance`, and the drifts exactly."""
        same = np.abs(np.log(self.deviation / other.deviation)) < tolerance
        return bool(np.all(same) and np.array_equal(self.drift, other.drift))


@cache
def whitening(drift: float, blocks: int) -> Array:
    """(blocks, blocks) map under which white noise plus a random walk becomes white; unit determinant.

    Residuals under two such maps then compare by their sums of squares alone.
    """
    walk = np.tril(np.ones((blocks, blocks)))
    root = np.linalg.cholesky(np.eye(blocks) + drift * walk @ walk.T)
    scale = np.exp(np.mean(np.log(np.diag(root))))
    return np.asarray(np.linalg.inv(root) * scale)


def likeliest_drift(error: Array) -> Array:
    """(5,) drift that makes residuals (5, windows, blocks) likeliest, white ones, channel by channel."""
    drift = np.zeros(len(error))
    for channel in MOTION_ROWS:
        squares = [float(np.sum((error[channel] @ whitening(d, error.shape[-1]).T) ** 2)) for d in DRIFTS]
        drift[channel] = DRIFTS[int(np.argmin(squares))]
    return drift
