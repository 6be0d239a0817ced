"""The model's motion over the blocks of a record, linearised about the smoothed states.

The states are x + e with x the smoothed ones and de/dt = A e + f(x, u) - dx/dt, solved block by block with the matrix
exponential; the same recursion carries every sensitivity.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hil_gateway.process.arrays import Array

ORDER, DOUBLINGS = 8, 3
"""Terms of the exponential series of an eighth of a block: |A| dt may be 8 at slow speed with stiff tyres."""
MOTION = (3, 4, 2)
"""Channels that are the derivatives of vx, vy, yaw_rate."""


@dataclass(frozen=True)
class Propagator:
    """The linearised motion of one record at one set of parameters.

    Attributes:
        decay, gain: (windows, blocks, 3, 3): e at the next edge is decay e + gain g, with g the defect.
        mean_decay, mean_gain: the same for the mean over the block.
    """

    decay: Array
    gain: Array
    mean_decay: Array
    mean_gain: Array

    @classmethod
    def make(cls, state_by: Array, step: float) -> Propagator:
        """Exponential series of every block, of a fraction of it first and then doubled (scaling and squaring).

        `state_by` (5, 3, windows, blocks) are the derivatives of the channels by vx, vy, yaw_rate; `step` in s.
        """
        shape = state_by.shape[2:]
        a = state_by[list(MOTION)].reshape(3, 3, -1) * (step / 2**DOUBLINGS)
        identity = np.eye(3)[:, :, None]
        power, decay, first, second = (np.broadcast_to(identity / d, a.shape).copy() for d in (1.0, 1.0, 1.0, 2.0))
        factorial = 1.0
        for j in range(1, ORDER):
            power = _product(power, a)
            factorial *= j
            decay += power / factorial
            first += power / (factorial * (j + 1))
            second += power / (factorial * (j + 1) * (j + 2))
        for _ in range(DOUBLINGS):
            second = (_product(first, first) + 2.0 * second) / 4.0
            first = _product(first, decay + identity) / 2.0
            decay = _product(decay, decay)
        rows = (np.ascontiguousarray(np.moveaxis(m, 2, 0)).reshape(*shape, 3, 3) for m in (decay, first, second))
        decay, first, second = rows
        return cls(decay, first, first, second)


def _product(a: Array, b: Array) -> Array:
    """Matrix products of (3, 3, n) by (3, 3, n): with n last, several times faster than `@` on small matrices."""
    return np.asarray(np.einsum("ijn,jkn->ikn", a, b))
