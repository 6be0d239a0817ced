"""How much tyre force the race line's speed profile may ask for, given load limits and belief (Eq. 10)."""

from __future__ import annotations

import numpy as np

from estimator.model.tyre import normalised_force
from hil_gateway.process.arrays import Array
from planner.problem.infomax import principal_steps

PROFILE_SHARE = 0.95
"""of what Eq. (10) leaves; the rest corrects errors"""
NEXT_LAP = 1.02
"""of the force that the front tyres have held in the laps before may be asked of them in the next: beyond their peak
they run wide, which shows in time; rear tyres beyond theirs turn the car round, and are asked for nothing more"""
STABLE, LEAST_REAR = 1.05, 0.94
"""the rear axle may use less of its peak where it is weaker than the front one: by how much it may be stronger before,
and the least share. A car whose rear axle gives way first has no steering that holds it there"""
MIN_CAPACITY = 0.3
"""over axle load; the car has to move. Asking for more than Eq. (10) leaves, bends were entered faster than plans could
follow them"""
MOST_SLIP = 0.35
"""rad; beyond it no bend is driven, whatever a tyre still gives there"""

Axles = tuple[tuple[int, int, int], tuple[int, int, int]]
"""positions of B, C and D in theta, of the front and of the rear axle"""


def capacity(
    axles: Axles, mean: Array, covariance: Array, *, use: Array, level: float, sustained: tuple[float, float]
) -> tuple[float, float]:
    """Force over axle load (front, rear) that may be asked of the tyres when a bend is entered.

    Two bounds, each with the probability of `level` standard deviations:

    - the force that a tyre with less grip than believed still gives within the share `use` of its peak. A force
      `sustained` before bounds it from below, as far as the mean agrees: where the car has been, the tyre has answered;
    - the force at the slip where the first of the sigma points reaches that share. The load rows hold there, so a
      profile that asks for more is not followed. Parameters that are only known together cost nothing where the force
      they give is known.
    """
    rows = np.array(axles)
    marginal = covariance[rows[:, :, None], rows[:, None, :]]
    peak, spread = mean[rows[:, 2]], np.sqrt(marginal[:, 2, 2])
    usable = np.maximum(use * (peak - level * spread), np.minimum(sustained, use * peak))
    front, rear = np.maximum(np.minimum(usable, _force_within(mean[rows], marginal, use, level)), MIN_CAPACITY)
    return float(front), float(rear)


def rear_share(peaks: Array) -> float:
    """Share of its load limit that the rear axle may use, from the peaks (front, rear) over axle load."""
    return min(1.0, max(LEAST_REAR, STABLE * float(peaks[1] / peaks[0])))


def sustained_next(sustained: tuple[float, float], laps_before: tuple[float, float]) -> tuple[float, float]:
    """What `capacity` may count on: forces over axle load (front, rear) `sustained` so far, and in whole laps."""
    return max(sustained[0], NEXT_LAP / PROFILE_SHARE * laps_before[0]), sustained[1]


def _force_within(mean: Array, covariance: Array, use: Array, level: float) -> Array:
    """Largest force over axle load (2,), by the mean, at slips where no choice of theta uses more than `use` (2,) of
    its peak; `mean` (2, 3) are B, C, D of both axles, `covariance` (2, 3, 3)."""
    steps = principal_steps(covariance, level)
    choices = mean[:, :, None] + np.concatenate([np.zeros_like(mean)[:, :, None], steps, -steps], axis=2)
    b, c, _ = np.maximum(choices, 0.1 * mean[:, :, None]).transpose(1, 0, 2)
    slip = np.minimum(slip_at_share(use[:, None], b, c).min(axis=1), MOST_SLIP)
    return np.asarray(normalised_force(slip, *mean.T))


def slip_at_share(use: Array, b: Array, c: Array) -> Array:
    """Slip angle where Eq. (2) reaches the share `use` of its peak: C atan(B alpha) = asin(use); inf where never."""
    phase = np.arcsin(use) / c
    return np.where(phase < 0.5 * np.pi, np.tan(np.minimum(phase, 0.5 * np.pi)) / b, np.inf)
