"""Whether a log has straights or turns both ways: on one circle a zero or an angle is its own cornering."""

from __future__ import annotations

import numpy as np

from hil_gateway.process.arrays import Array

STRAIGHT = 0.1
"""Share of the sharpest path (99th percentile) below which the car goes nearly straight."""
LEAST_STRAIGHT = 0.02
"""Share of the samples that must be nearly straight, or turn the other way, for a zero to be seen and not extrapolated:
a constant steering on a constant circle is its own zero."""


def goes_straight(path: Array) -> bool:
    """Whether the curvature driven, (n,) 1/m, comes to zero often enough, or has either sign."""
    if not len(path):
        return False
    one_way = path * np.sign(np.median(path))
    return float(np.mean(one_way < STRAIGHT * np.quantile(np.abs(path), 0.99))) > LEAST_STRAIGHT
