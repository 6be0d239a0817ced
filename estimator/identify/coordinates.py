"""Coordinates in which steps are taken: cornering stiffness B C D, C and D instead of B, C and D.

At small slip only the product B C D shows; in B, C, D the sum of squares is a long curved valley along which
Gauss-Newton crawls, in these coordinates it is nearly straight. The estimate itself is unchanged.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from estimator.model.parameters import Parameter

Array = NDArray[np.float64]


class StepCoordinates:
    """Map between scaled parameters u = (theta - prior) / prior_std and step coordinates w.

    w equals u but for each axle's B and D, which become log(B C D) and log D.
    """

    def __init__(self, table: Sequence[Parameter]) -> None:
        """Find the (B, C, D) of each axle in `table`; the parameter table names them b, bf or br and so on."""
        names = [p.name for p in table]
        self.prior = np.array([p.prior for p in table])
        self.scale = np.array([p.prior_std for p in table])
        axles = [suffix for suffix in ("", "f", "r") if f"b{suffix}" in names]
        self.axles = [tuple(names.index(letter + suffix) for letter in "bcd") for suffix in axles]

    def forward(self, u: Array) -> Array:
        """u (p,) -> w (p,)."""
        theta, w = self.prior + self.scale * u, u.copy()
        for b, c, d in self.axles:
            w[b], w[d] = np.log(theta[b] * theta[c] * theta[d]), np.log(theta[d])
        return w

    def inverse(self, w: Array) -> Array:
        """w (p,) -> u (p,)."""
        u = w.copy()
        for b, c, d in self.axles:
            C, D = self.prior[c] + self.scale[c] * w[c], np.exp(w[d])
            u[b] = (np.exp(w[b]) / (C * D) - self.prior[b]) / self.scale[b]
            u[d] = (D - self.prior[d]) / self.scale[d]
        return u

    def tangent(self, u: Array) -> Array:
        """du/dw (p, p) at u."""
        theta, T = self.prior + self.scale * u, np.eye(len(u))
        for b, c, d in self.axles:
            B, C, D = theta[b], theta[c], theta[d]
            T[b, b] = B / self.scale[b]
            T[b, c] = -B / C * self.scale[c] / self.scale[b]
            T[b, d] = -B / self.scale[b]
            T[d, d] = D / self.scale[d]
        return T

    def box(self, lower: Array, upper: Array) -> tuple[Array, Array]:
        """Bounds of u as bounds of w; those of B have none here and are kept by clipping u."""
        low, high = lower.copy(), upper.copy()
        for b, _, d in self.axles:
            low[b], high[b] = -np.inf, np.inf
            low[d] = np.log(self.prior[d] + self.scale[d] * lower[d])
            high[d] = np.log(self.prior[d] + self.scale[d] * upper[d])
        return low, high
