"""Steps of a fit: damped, inside the bounds, along coordinates in which the minimum is no curved valley."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimator.offline.fit.normal import Normal
from hil_gateway.process.arrays import Array

LARGEST_LOG_STEP = 0.4
DECADES = 1e3
"""A positive effect parameter whose bounds lie farther apart than by this factor steps in its logarithm: a plain step
from far above would leap to where its effect is gone, and stay there."""
RIDGE = 1e-11


@dataclass(frozen=True)
class Coordinates:
    """Step coordinates log(B C D), log C, log(B sqrt(2 + C^2)) of each axle instead of B, C, D; of the other
    parameters themselves, or their logarithm where they reach over decades.

    F = B C D a (1 - B^2 (2 + C^2) a^2 / 6 + ...) at a slip a: below the peak of Eq. (2) a drive shows the product and
    how the force bends, and the minimum lies in a long valley along which both stay. It is straight in these.

    Attributes:
        axles: indices of B, C, D of each axle; scales: indices of parameters that reach over decades.
        lower, upper: (p,) bounds of the parameters.
    """

    axles: tuple[tuple[int, int, int], ...]
    scales: tuple[int, ...]
    lower: Array
    upper: Array

    @classmethod
    def of(cls, tyre: Sequence[str], lower: Array, upper: Array) -> Coordinates:
        """Coordinates for parameters that begin with those of the tyre."""
        axles = [axle for axle in ("", "f", "r") if f"b{axle}" in tyre]
        wide = np.flatnonzero((lower > 0) & (upper > DECADES * lower))
        scales = tuple(int(i) for i in wide if i >= len(tyre))
        places = tuple((tyre.index(f"b{a}"), tyre.index(f"c{a}"), tyre.index(f"d{a}")) for a in axles)
        return cls(places, scales, lower, upper)

    def damped_step(self, normal: Normal, at: Array, damping: float) -> tuple[Array, float]:
        """Next parameters, and the fall of the deviance that the quadratic predicts.

        A Levenberg-Marquardt step in which what would leave its bounds goes just there. One that is too long in a
        logarithm is shortened as a whole: shape and peak of a tyre go together, and with either cut short alone the
        step would leave the valley it goes along.
        """
        tangent = self._tangent(at)
        total = tangent.T @ normal.precision(normal.variance) @ tangent
        pull = tangent.T @ normal.pull(normal.variance)
        low, high = self._room(at)
        step, free = np.zeros(len(at)), np.ones(len(at), bool)
        while free.any():
            rest = pull[free] - total[np.ix_(free, ~free)] @ step[~free]
            step[free] = _damped_solve(total[np.ix_(free, free)], rest, damping)
            outside = free & ((step < low) | (step > high))
            if not outside.any():
                break
            step[outside] = np.clip(step, low, high)[outside]
            free &= ~outside
        step *= self._share_of(step)
        return np.clip(self._advance(at, step), self.lower, self.upper), float(step @ (2.0 * pull - total @ step))

    def _tangent(self, at: Array) -> Array:
        """(p, p) derivative of the parameters by the step coordinates."""
        out = np.eye(len(at))
        for b, c, d in self.axles:
            bends = at[c] ** 2 / (2.0 + at[c] ** 2)
            out[b, b], out[b, c], out[b, d] = 0.0, -at[b] * bends, at[b]
            out[c, c] = at[c]
            out[d, b], out[d, c], out[d, d] = at[d], at[d] * (bends - 1.0), -at[d]
        for i in self.scales:
            out[i, i] = at[i]
        return out

    def _room(self, at: Array) -> tuple[Array, Array]:
        """Least and largest step in each coordinate."""
        low, high = self.lower - at, self.upper - at
        for b, _, d in self.axles:
            low[[b, d]], high[[b, d]] = -np.inf, np.inf
        for i in (*(c for _, c, _ in self.axles), *self.scales):
            low[i], high[i] = np.log(self.lower[i] / at[i]), np.log(self.upper[i] / at[i])
        return low, high

    def _share_of(self, step: Array) -> float:
        """Share of a step at which no logarithm moves by more than `LARGEST_LOG_STEP`."""
        logarithms = [*(i for axle in self.axles for i in axle), *self.scales]
        longest = float(np.abs(step[logarithms]).max(initial=0.0))
        return min(1.0, LARGEST_LOG_STEP / longest) if longest > 0.0 else 1.0

    def _advance(self, at: Array, step: Array) -> Array:
        """Parameters after a step in step coordinates."""
        out = at + step
        for b, c, d in self.axles:
            out[c] = at[c] * np.exp(step[c])
            out[b] = at[b] * np.exp(step[d]) * np.sqrt((2.0 + at[c] ** 2) / (2.0 + out[c] ** 2))
            out[d] = at[b] * at[c] * at[d] * np.exp(step[b]) / (out[b] * out[c])
        for i in self.scales:
            out[i] = at[i] * np.exp(step[i])
        return out


def _damped_solve(total: Array, pull: Array, damping: float) -> Array:
    scale = np.sqrt(np.maximum(np.diag(total), 1e-300))
    scaled = total / scale[:, None] / scale + (damping + RIDGE) * np.eye(len(scale))
    step: Array = np.linalg.solve(scaled, pull / scale) / scale
    return step
