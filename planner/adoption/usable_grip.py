"""How much tyre force the race line's speed profile may ask for, given load limits and belief (Eq. 10)."""

from __future__ import annotations

import numpy as np

from estimator.model.tyre import normalised_force
from hil_gateway.process.arrays import Array
from planner.problem.infomax import sigma_points

PROFILE_SHARE = 0.95
"""of what Eq. (10) leaves; the rest corrects errors"""
MIN_CAPACITY = 0.3
"""over axle load; the car has to move. Asking for more than Eq. (10) leaves, bends were entered faster than plans could
follow them"""
SLIPS = np.linspace(0.0, 0.35, 176)
"""slip angles among which the usable one is sought, rad"""

Axles = tuple[tuple[int, int, int], tuple[int, int, int]]
"""positions of B, C and D in theta, of the front and of the rear axle"""


def capacity(
    axles: Axles, mean: Array, covariance: Array, *, use: float, level: float, held: tuple[float, float]
) -> tuple[float, float]:
    """Force over axle load (front, rear) that may be asked of the tyres when a bend is entered.

    Two bounds, each with the probability of `level` standard deviations:

    - the force that a tyre with less grip than believed still gives within the share `use` of its peak. A force `held`
      before bounds it from below, as far as the mean agrees: where the car has been, the tyre has answered;
    - the force at the slip where the first of the sigma points reaches that share. The load rows hold there, so a
      profile that asks for more is not followed. Parameters that are only known together cost nothing where the force
      they give is known.
    """
    both = []
    for axle, shown in zip(axles, held, strict=True):
        peak, spread = mean[axle[2]], float(np.sqrt(covariance[axle[2], axle[2]]))
        borne = max(use * (peak - level * spread), min(shown, use * peak))
        both.append(max(min(borne, _force_within(axle, mean, covariance, use, level)), MIN_CAPACITY))
    return both[0], both[1]


def _force_within(axle: tuple[int, int, int], mean: Array, covariance: Array, use: float, level: float) -> float:
    """Largest force over axle load, by the mean, at slips where no choice of theta uses more than `use` of its peak."""
    choices = np.column_stack([mean, sigma_points(mean, covariance, axle, level)])[list(axle)]
    shares = lateral_shape(np.vstack([choices[:2], np.ones(choices.shape[1])]))
    beyond = np.flatnonzero((shares > use).any(axis=1))
    within = shares[: beyond[0] if len(beyond) else None, 0]
    return float(within.max(initial=0.0) * mean[axle[2]])


def lateral_shape(tyre: Array) -> Array:
    """Eq. (2) over the axle load at `SLIPS` for K tyres (B, C, D), shape (3, K) -> (len(SLIPS), K)."""
    b, c, d = tyre
    return np.asarray(normalised_force(SLIPS[:, None], b, c, d))
