"""Profiles over the lap: periodic cubic splines of track position (grade, bank, any empirical term).

A profile is its coefficients on equal intervals of the lap; the value at s is sum_j c_j B((s / length) n - j)
with the cardinal cubic B-spline B and everything taken modulo the lap (de Boor, A Practical Guide to Splines).
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from hil_gateway.process.arrays import Array, Expr


def profile_basis(position: Array, length: float, coefficients: int) -> Array:
    """Basis matrix, shape (n, coefficients): profile values are `basis @ c`; periodic in `length` m."""
    offset = position[:, None] * (coefficients / length) - np.arange(coefficients)
    return _cardinal(np.abs((offset + 0.5 * coefficients) % coefficients - 0.5 * coefficients))


def profile_value(position: Expr, length: float, coefficients: Sequence[float]) -> Expr:
    """Value at a symbolic track position, m; the same spline as `profile_basis`, twice differentiable."""
    n = len(coefficients)
    total: Expr = 0.0
    for j, c in enumerate(coefficients):
        turns = (position / length) * n - j + 0.5 * n
        distance = ca.fabs(turns - n * ca.floor(turns / n) - 0.5 * n)
        far, near = ca.fmax(2.0 - distance, 0.0), ca.fmax(1.0 - distance, 0.0)
        total = total + c * (far**3 - 4.0 * near**3) / 6.0
    return total


def profile_roughness(length: float, coefficients: int) -> Array:
    """Second differences over the lap, shape (coefficients, coefficients): |R c|^2 is the smoothness penalty.

    Scaled to the mean squared second derivative with respect to lap fraction, so that a prior does not depend
    on how many coefficients are used.
    """
    identity = np.eye(coefficients)
    second = np.roll(identity, 1, axis=1) - 2.0 * identity + np.roll(identity, -1, axis=1)
    scaled: Array = second * coefficients**2 / np.sqrt(coefficients) / (2.0 * np.pi) ** 2
    return scaled


def _cardinal(distance: Array) -> Array:
    far, near = np.maximum(2.0 - distance, 0.0), np.maximum(1.0 - distance, 0.0)
    value: Array = (far**3 - 4.0 * near**3) / 6.0
    return value
