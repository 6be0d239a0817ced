"""What is left of each measured signal when a model is fitted: the sensor's white noise, and a drift of the motion.

A missing force acts on the acceleration, so in a velocity its trace is no white noise but a random walk. Its variance
says how far the simulated motion can be trusted (see `innovations`); without model error it is zero.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from estimator.offline.record.record import STATE_ROWS
from hil_gateway.process.arrays import Array

DRIFTS = (0.0, *(float(d) for d in np.geomspace(1e-3, 1e3, 13)))
"""Variance of the random walk's step per block, relative to that of the white noise, that are tried."""


LEAST_GAIN = 1e-3
"""Least fall of the deviance per block for another drift: less is no reason to fit anew."""


@dataclass(frozen=True)
class ResidualNoise:
    """Noise of the measured signals.

    Attributes:
        deviation: (5,) standard deviation of the white noise of a block mean.
        drift: (5,) variance of the random walk's step per block, relative to the white noise; 0: white.
    """

    deviation: Array
    drift: Array

    @classmethod
    def white(cls, deviation: Array) -> ResidualNoise:
        """White noise in every channel."""
        return cls(deviation, np.zeros(len(deviation)))

    def close_to(self, other: ResidualNoise, tolerance: float) -> bool:
        """Whether the deviations agree within a relative `tolerance`, and the drifts exactly."""
        same = np.abs(np.log(self.deviation / other.deviation)) < tolerance
        return bool(np.all(same) and np.array_equal(self.drift, other.drift))


def likeliest(
    noise: ResidualNoise, used: NDArray[np.bool_], deviance: Callable[[ResidualNoise], float]
) -> ResidualNoise:
    """`noise` with the drifts of least `deviance`: used channels in turn, along `DRIFTS` from where they are."""
    best = deviance(noise)
    for row in (r for r in sorted(STATE_ROWS) if used[r]):
        at = int(np.argmin(np.abs(np.array(DRIFTS) - noise.drift[row])))
        for direction in (1, -1):
            start = at
            while 0 <= at + direction < len(DRIFTS):
                drift = noise.drift.copy()
                drift[row] = DRIFTS[at + direction]
                tried = replace(noise, drift=drift)
                value = deviance(tried)
                if value > best - LEAST_GAIN:
                    break
                noise, best, at = tried, value, at + direction
            if at != start:
                break
    return noise
