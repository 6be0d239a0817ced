"""The ratio of two signals as it is lately: least squares of y = k x that forgets."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class FadingRatio:
    """k, as the newest pairs tell it; `weight` is that of one of them."""

    weight: float
    xy: float = 0.0
    """mean of x y"""
    xx: float = 0.0
    """mean of x^2"""

    def learn(self, y: float, x: float) -> None:
        """A pair."""
        self.xy += self.weight * (y * x - self.xy)
        self.xx += self.weight * (x**2 - self.xx)

    @property
    def alone(self) -> float:
        """k; less where x was next to nothing (below 1, root mean square)."""
        return self.xy / max(self.xx, 1.0)

    def ratio(self, expected: float) -> float:
        """k; as `expected` where x was nothing."""
        return (self.xy + expected) / (self.xx + 1.0)
