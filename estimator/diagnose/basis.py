"""Bases over one signal: periodic splines over the lap or the heading, hat functions over anything else."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.model.profile import profile_basis, profile_roughness

Array = NDArray[np.float64]

KNOT_M = 70.0
"""Distance of the knots of a profile over the lap, m."""
PROFILE_COEFFICIENTS = (12, 60)
HEADING_COEFFICIENTS = 12
TIME_COEFFICIENTS = 20
QUANTILES = (0.0, 0.01, 0.05, 0.15, 0.3, 0.42, 0.5, 0.58, 0.7, 0.85, 0.95, 0.99, 1.0)
"""Knots over a signal without a period: dense in the middle, where a sign changes, and out to the ends."""
FEW_VALUES = 6
"""A signal with no more distinct values has a knot at each."""
PERIODIC_ROUGHNESS, ROUGHNESS = 4.0, 3.0
"""Prior: second difference per coefficient in units of the prior standard deviation of the value."""


@dataclass(frozen=True)
class Basis:
    """A function of one signal as `matrix(signal) @ coefficients`.

    `knots` are those of hat functions; a periodic basis has none, but a `period` and a number of coefficients.
    """

    signal: str
    size: int
    period: float = 0.0
    knots: tuple[float, ...] = ()

    def matrix(self, signal: Array) -> Array:
        """(n, size) values of the basis at an (n,) signal; constant beyond the last knots."""
        if self.period:
            return profile_basis(signal, self.period, self.size)
        knots = np.array(self.knots)
        at = np.clip(signal, knots[0], knots[-1])
        i = np.clip(np.searchsorted(knots, at, side="right") - 1, 0, self.size - 2)
        share = (at - knots[i]) / (knots[i + 1] - knots[i])
        out = np.zeros((len(signal), self.size))
        rows = np.arange(len(signal))
        out[rows, i], out[rows, i + 1] = 1.0 - share, share
        return out

    def precision(self, std: float) -> Array:
        """(size, size) prior precision of the coefficients: size about `std`, and smooth."""
        if self.period:
            rough = profile_roughness(self.period, self.size) / (PERIODIC_ROUGHNESS * std)
        else:
            rough = np.diff(np.eye(self.size), 2, axis=0) / (ROUGHNESS * std)
        precision: Array = np.eye(self.size) / std**2 + rough.T @ rough
        return precision


def make_basis(name: str, values: Array, lap_length: float) -> Basis:
    """The basis for a signal, placed by the values it takes."""
    if name == "track_position":
        low, high = PROFILE_COEFFICIENTS
        return Basis(name, int(np.clip(round(lap_length / KNOT_M), low, high)), period=max(lap_length, 1.0))
    if name == "yaw":
        return Basis(name, HEADING_COEFFICIENTS, period=2 * np.pi)
    distinct = np.unique(values.ravel()[:: max(1, values.size // 5000)])
    if len(distinct) <= FEW_VALUES:
        return Basis(name, len(distinct), knots=tuple(float(v) for v in distinct))
    if name == "t":
        knots = np.linspace(values.min(), values.max(), TIME_COEFFICIENTS)
    else:
        knots = np.quantile(values, QUANTILES)
        gap = 0.004 * (knots[-1] - knots[0])
        kept = [knots[0]]
        for knot in knots[1:]:
            if knot > kept[-1] + gap:
                kept.append(knot)
        knots = np.array(kept)
    return Basis(name, len(knots), knots=tuple(float(v) for v in knots))
