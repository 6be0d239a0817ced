"""Held-out evidence of a larger model over a smaller one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimator.offline.fit.normal import TINY
from hil_gateway.process.arrays import Array

SIGNIFICANCE, SIGNIFICANCE_TO_STAY = 2.0, 1.0
"""The mean gain per stretch must exceed so many of its standard errors: to be accepted, and to stay so."""


@dataclass(frozen=True)
class Evidence:
    """Held-out gain of a larger model over a smaller one.

    Attributes:
        gain: log-likelihood, natural log, summed over laps and channels.
        channels: (5,) its parts.
        laps: (laps,) its parts.
    """

    gain: float
    channels: Array
    laps: Array

    @property
    def channel(self) -> int:
        """Row of the channel that gains most."""
        return int(np.argmax(self.channels))

    @property
    def consistent(self) -> bool:
        """Whether the gain per stretch is positive beyond its scatter, and in either half of the time."""
        return self._significant(SIGNIFICANCE) and self.in_both_halves

    @property
    def still_consistent(self) -> bool:
        """The same for what was accepted before: a lower threshold than for acceptance, so that the search settles."""
        return self.beyond_scatter and self.in_both_halves

    @property
    def beyond_scatter(self) -> bool:
        """Whether the gain per stretch is positive beyond its scatter, by the threshold to stay."""
        return self._significant(SIGNIFICANCE_TO_STAY)

    @property
    def in_both_halves(self) -> bool:
        """Whether neither half of the stretches loses what the other gains."""
        middle = len(self.laps) // 2
        return middle == 0 or bool(self.laps[:middle].sum() > 0 and self.laps[middle:].sum() > 0)

    def _significant(self, errors: float) -> bool:
        spread = self.laps.std(ddof=1) / np.sqrt(len(self.laps)) if len(self.laps) > 1 else 0.0
        return bool(self.laps.mean() > errors * spread or np.all(self.laps > 0))


def compare(before: Array, after: Array, count: Array) -> Evidence:
    """Held-out evidence from squares (5, laps) of two models, variances concentrated out per channel."""
    total = float(count.sum())
    channels = 0.5 * total * np.log(np.maximum(before.sum(1), TINY) / np.maximum(after.sum(1), TINY))
    difference = before - after
    whole = difference.sum(1)
    weight = np.divide(channels, whole, out=np.zeros(5), where=np.abs(whole) > 1e-12)
    laps = np.einsum("cl,c->l", difference, np.abs(weight))
    return Evidence(float(channels.sum()), channels, laps)
