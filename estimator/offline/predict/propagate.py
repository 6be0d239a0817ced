"""The model's motion over the blocks of a record, linearised about the smoothed states.

The states are x + e with x the smoothed ones and de/dt = A e + f(x, u) - dx/dt, solved block by block with the matrix
exponential; the same recursion carries every sensitivity.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from estimator.offline.predict.compiled_windows import VECTOR, windows_library
from estimator.offline.record.record import STATE_ROWS
from hil_gateway.process.arrays import Array

ORDER = 8
"""Terms of the exponential series"""
SERIES_NORM = 0.5
"""Largest norm of what the series is taken of: its first missing term is then below 1e-7."""


@dataclass(frozen=True)
class Propagator:
    """The linearised motion of one record at one set of parameters.

    Attributes:
        decay, gain: (3, 3, blocks, windows): e at the next edge is decay e + gain g, with g the defect.
        mean_decay, mean_gain: the same for the mean over the block.
        forces_by: (2, 3, blocks, windows) derivatives of ax, ay by the states.
    """

    decay: Array
    gain: Array
    mean_decay: Array
    mean_gain: Array
    forces_by: Array

    @classmethod
    def make(cls, state_by: Array, step: float) -> Propagator:
        """Linearise: `state_by` (5, 3, windows, blocks) are the derivatives of the channels by vx, vy, yaw_rate.

        `step` in s.
        """
        by_block = np.ascontiguousarray(state_by.swapaxes(2, 3))
        decay, first, second = exponentials(by_block[STATE_ROWS] * step)
        return cls(decay, first, first, second, by_block[:2])


def exponentials(a: Array) -> tuple[Array, Array, Array]:
    """exp(a) and its first and second integral over the block, of (3, 3, blocks, windows), each of that shape.

    Series of a fraction of a block first, then doubled (scaling and squaring; Golub and Van Loan, Matrix Computations,
    9.3): a car that is small and slow decays a hundred times within a block.
    """
    doublings = _doublings(a)
    a = a / 2**doublings
    library = windows_library()
    if library is None or a[0, 0].size < VECTOR:
        return _exponentials(a, doublings)
    decay, first, second = (np.empty_like(a) for _ in range(3))
    library.call("exponentials", a[0, 0].size, ORDER, doublings, a, decay, first, second)
    return decay, first, second


def _doublings(a: Array) -> int:
    """Halvings of a block after which every matrix is within `SERIES_NORM`."""
    largest = float(np.abs(a).sum(axis=1).max(initial=0.0))
    return max(0, math.ceil(math.log2(largest / SERIES_NORM))) if largest > SERIES_NORM else 0


def _exponentials(a: Array, doublings: int) -> tuple[Array, Array, Array]:
    identity = np.eye(3)[:, :, None, None]
    power, decay, first, second = (np.broadcast_to(identity / d, a.shape).copy() for d in (1.0, 1.0, 1.0, 2.0))
    factorial = 1.0
    for j in range(1, ORDER):
        power = product(power, a)
        factorial *= j
        decay += power / factorial
        first += power / (factorial * (j + 1))
        second += power / (factorial * (j + 1) * (j + 2))
    for _ in range(doublings):
        second = (product(first, first) + 2.0 * second) / 4.0
        first = product(first, decay + identity) / 2.0
        decay = product(decay, decay)
    return decay, first, second


def product(a: Array, b: Array) -> Array:
    """Matrix products of (i, j, blocks, windows) by (j, k, blocks, windows).

    With the samples last, several times faster than `@` on small matrices.
    """
    return np.asarray(np.einsum("ijbw,jkbw->ikbw", a, b))
