"""What tyres and brakes deliver now of what is believed of them: a wet road, a flat tyre, hot brakes.

The belief is about what lasts, and learns over seconds. What is missing at this moment is taken off at once, and comes
back as slowly as parameters in force may change.
"""

from __future__ import annotations

import numpy as np

from hil_gateway.bus.delivered import Delivered
from hil_gateway.process.arrays import Array
from planner.adoption.usable_grip import Axles
from planner.problem.load_limits import SLEW

USUAL = 0.87
"""share down to which model errors explain what is missing: a healthy car at its limit delivers 0.88 to 1.13"""
USUAL_BRAKES = 0.8
"""the same of the brakes, whose force is late where a stop begins; a share in between is driven through"""
LEAST = 0.5
"""share that is believed at least: a wet road or an axle with a flat tyre gives more"""
RELEASE = 0.85
"""of the braking of an axle that is left each plan while its wheels lock: brakes act three or four plans late, and
locked wheels roll again with half of what locked them"""


class DeliveredShares:
    """Shares of the believed peak of front and rear tyres, `tyres`, and of the force of the `brakes`."""

    def __init__(self) -> None:
        self.tyres = (1.0, 1.0)
        self.brakes = 1.0
        self.rolling = (1.0, 1.0)
        """share of the braking that an axle may be asked for, front and rear, with which its wheels roll"""

    def take(self, seen: Delivered | None) -> bool:
        """Take in the newest estimate's, once a plan; whether anything has changed."""
        if seen is None:
            return False
        before = self.tyres, self.brakes, self.rolling
        front, rear = self.tyres
        self.tyres = _follow(front, seen.front, USUAL), _follow(rear, seen.rear, USUAL)
        self.brakes = _follow(self.brakes, seen.brakes, USUAL_BRAKES)
        front_rolls, rear_rolls = (
            max(RELEASE * share, LEAST) if locks else min(share * (1.0 + SLEW), 1.0)
            for share, locks in zip(self.rolling, seen.locking, strict=True)
        )
        self.rolling = front_rolls, rear_rolls
        return (self.tyres, self.brakes, self.rolling) != before

    def acting(self, drive: float) -> float:
        """Drive command, by the force it has, of one that is sent or reported."""
        return drive * self.brakes if drive < 0.0 else drive

    def sent(self, drive: float) -> float:
        """Drive command to send for one by the force it is to have."""
        return drive / self.brakes if drive < 0.0 else drive


def _follow(share: float, seen: float | None, usual: float) -> float:
    """Down at once, up by `SLEW`, all where more than is `usual` is seen; nothing seen, nothing changes."""
    if seen is None:
        return share
    present = 1.0 if seen > usual else max(seen, LEAST)
    return min(present, share * (1.0 + SLEW))


def grip_factors(axles: Axles, tyres: tuple[float, float], parameters: int) -> Array:
    """Factor on each of so many parameters: `tyres` (front, rear) on D of the axles, 1 on all others."""
    factors = np.ones(parameters)
    for (_, _, d), share in zip(axles, tyres, strict=True):
        factors[d] = min(factors[d], share)
    return factors
