"""How much tyre force the race line's speed profile may ask for, given load limits and belief (Eq. 10)."""

from __future__ import annotations

import numpy as np

from estimator.model.tyre import normalised_force
from hil_gateway.process.arrays import Array
from planner.plan.controller import TyreKnowledge
from planner.problem.infomax import sigma_points

PROFILE_SHARE = 0.92
"""of what Eq. (10) leaves; the rest corrects errors"""
MIN_SHARE = 0.1
"""the car has to move; asking for more than Eq. (10) leaves, bends were entered faster than plans could follow them"""
SLIPS = np.linspace(0.0, 0.35, 176)
"""slip angles among which the usable one is sought, rad"""

Axles = tuple[tuple[int, int, int], tuple[int, int, int]]
"""positions of B, C and D in theta, of the front and of the rear axle"""


def usable_share(axles: Axles, knowledge: TyreKnowledge, level: float) -> float:
    """Share of the model's peak tyre force the speed profile may ask for.

    The load rows hold at the same slip for every choice of theta. So the profile goes as far as the slip at which the
    first of the sigma points reaches the limit: parameters that are only known together cost nothing where the
    force they give is known.
    """
    shares = []
    for axle, limit in zip(axles, knowledge.load_asked, strict=True):
        points = sigma_points(knowledge.mean, knowledge.covariance, axle, level)
        forces = lateral_shape(np.column_stack([knowledge.theta, points])[list(axle)])
        beyond = np.flatnonzero((forces > limit).any(axis=1))
        within = forces[: beyond[0] if len(beyond) else None, 0]
        shares.append(within.max(initial=0.0) / knowledge.theta[axle[2]])
    return float(np.clip(PROFILE_SHARE * min(shares), MIN_SHARE, 0.95))


def lateral_shape(tyre: Array) -> Array:
    """Eq. (2) over the axle load at `SLIPS` for K tyres (B, C, D), shape (3, K) -> (len(SLIPS), K)."""
    b, c, d = tyre
    return np.asarray(normalised_force(SLIPS[:, None], b, c, d))


def usable_grip(axles: Axles, knowledge: TyreKnowledge, level: float) -> float:
    """Mean over the axles of the force over load that the profile may ask for."""
    return usable_share(axles, knowledge, level) * float(np.mean([knowledge.theta[axle[2]] for axle in axles]))
