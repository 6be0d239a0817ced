"""Bases over one signal: periodic splines over the lap or the heading, hat functions over anything else.

Once a function is roughly known its knots move to where it changes: a step, the edges of a stretch of track or a
threshold then cost no more coefficients than a slow change.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimator.model.profile import profile_basis, profile_roughness
from hil_gateway.process.arrays import Array

KNOT_M = 70.0
"""Distance of the knots of a profile over the lap, m."""
PROFILE_COEFFICIENTS = (12, 60)
HEADING_COEFFICIENTS = 12
TIME_COEFFICIENTS = 12
"""Wider than the stretches held out: a knot that only one of them determines predicts nothing there."""
QUANTILES = (0.0, 0.01, 0.05, 0.15, 0.3, 0.42, 0.5, 0.58, 0.7, 0.85, 0.95, 0.99, 1.0)
"""Knots over a signal without a period: dense in the middle, where a sign changes, and out to the ends."""
LEVEL_SHARE = 0.01
"""Prior standard deviation of a mean that is nothing, over that of the function: less than any term states"""
FEW_VALUES = 6
"""A signal with no more distinct values has a knot at each."""
PERIODIC_ROUGHNESS, ROUGHNESS = 4.0, 3.0
"""Prior: second difference per coefficient in units of the prior standard deviation of the value."""


@dataclass(frozen=True)
class Basis:
    """A function of one signal as `matrix(signal) @ coefficients`.

    `knots` are those of hat functions, which go around where there is a `period`. Without knots: periodic cubic splines
    on equal intervals. `level` (size,) are weights of a mean of the function that is nothing, where there is one.
    """

    signal: str
    size: int
    period: float = 0.0
    knots: tuple[float, ...] = ()
    level: tuple[float, ...] = ()

    def matrix(self, signal: Array) -> Array:
        """(n, size) values of the basis at an (n,) signal; constant beyond the last knots."""
        if self.period and not self.knots:
            return profile_basis(signal, self.period, self.size)
        knots = np.array(self.knots)
        if self.period:
            signal = (signal - knots[0]) % self.period + knots[0]
            knots = np.append(knots, knots[0] + self.period)
        at = np.clip(signal, knots[0], knots[-1])
        i = np.clip(np.searchsorted(knots, at, side="right") - 1, 0, len(knots) - 2)
        share = (at - knots[i]) / (knots[i + 1] - knots[i])
        out = np.zeros((len(signal), self.size))
        rows = np.arange(len(signal))
        out[rows, i], out[rows, (i + 1) % self.size] = 1.0 - share, share
        return out

    def precision(self, std: float) -> Array:
        """(size, size) prior precision of the coefficients: size about `std`, and smooth."""
        if self.period and not self.knots:
            rough = profile_roughness(self.period, self.size) / (PERIODIC_ROUGHNESS * std)
        elif self.period:
            around = np.eye(self.size)[np.arange(-1, self.size + 1) % self.size]
            rough = np.diff(around, 2, axis=0) / (ROUGHNESS * std)
        else:
            rough = np.diff(np.eye(self.size), 2, axis=0) / (ROUGHNESS * std)
        precision: Array = np.eye(self.size) / std**2 + rough.T @ rough
        if self.level:
            precision += np.outer(self.level, self.level) / (LEVEL_SHARE * std) ** 2
        return precision

    def moved(self, coefficients: Array, values: Array) -> Basis:
        """Hat functions with knots where the function with these `coefficients` changes over the `values` driven."""
        low, high = (0.0, self.period) if self.period else (float(values.min()), float(values.max()))
        grid = np.linspace(low, high, GRID)
        change = np.abs(np.diff(self.matrix(grid) @ coefficients))
        known = np.histogram(values % self.period if self.period else values, grid)[0]
        density = WHERE_IT_CHANGES * change / max(float(change.sum()), 1e-12)
        density += 0.5 * (1 - WHERE_IT_CHANGES) * (known / known.sum() + 1.0 / (GRID - 1))
        size = int(np.clip(self.size, *MOVED_KNOTS))
        reached = np.concatenate([[0.0], np.cumsum(density)]) / density.sum()
        knots = np.interp(np.linspace(0.0, 1.0, size, endpoint=not self.period), reached, grid)
        return Basis(self.signal, size, self.period, tuple(float(k) for k in knots))


@dataclass(frozen=True)
class Proportional(Basis):
    """A function in proportion to its signal: one coefficient."""

    def matrix(self, signal: Array) -> Array:
        """(n, 1) the signal itself."""
        return signal[:, None]

    def precision(self, std: float) -> Array:
        """(1, 1) prior precision of the factor."""
        return np.full((1, 1), 1.0 / std**2)


GRID, WHERE_IT_CHANGES, MOVED_KNOTS = 2001, 0.6, (24, 48)
"""Points on which a function is looked at; share of the knots put where it changes, the others over where it was driven
and over its whole range; least and most knots."""


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
