"""The newest position fix, and whether a row of them says that the car moves: independent of the wheels."""

from __future__ import annotations

import math
from dataclasses import dataclass

from hil_gateway.process.clock import NS_PER_S

MOVING = 5.0
"""m/s: slower, the way between fixes is no longer than what they may be apart"""
ROW = 10
"""fixes (0.5 s) that each lead further on: a jump of the receiver is one, and noise turns back"""


@dataclass(slots=True)
class Fixes:
    """Position in the local map, m, its number and when it came."""

    x: float = 0.0
    y: float = 0.0
    seq: int = 0
    stamp_ns: int = 0
    _step: tuple[float, float] = (0.0, 0.0)
    _row: int = 0

    def take(self, x: float, y: float, stamp_ns: int) -> None:
        """The next fix."""
        step = x - self.x, y - self.y
        same_way = step[0] * self._step[0] + step[1] * self._step[1] > 0
        onward = math.hypot(*step) * NS_PER_S > MOVING * (stamp_ns - self.stamp_ns)
        self._row = self._row + 1 if same_way and onward else 0
        self._step, self.stamp_ns = step, stamp_ns
        self.x, self.y = x, y
        self.seq += 1

    @property
    def moving(self) -> bool:
        """Whether the last ones, all of them, say so."""
        return self._row >= ROW
