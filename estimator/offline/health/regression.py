"""Robust linear regression with errors from parts of the log left out in turn."""

from __future__ import annotations

import numpy as np

from hil_gateway.process.arrays import Array

PARTS = 12


def jackknifed(X: Array, y: Array) -> tuple[Array, Array]:
    """Coefficients (k,) of y (n,) on X (n, k), and their standard deviations (jackknife over `PARTS` of the log)."""
    parts = np.array_split(np.arange(len(X)), PARTS)
    left_out = np.array([_robust(np.delete(X, part, 0), np.delete(y, part)) for part in parts])
    spread = np.sqrt((PARTS - 1) / PARTS * np.sum((left_out - left_out.mean(axis=0)) ** 2, axis=0))
    return _robust(X, y), np.asarray(spread, float)


def _robust(X: Array, y: Array) -> Array:
    weights = np.ones(len(y))
    solution: Array = np.zeros(X.shape[1])
    for _ in range(4):
        solution = np.asarray(np.linalg.lstsq(X * weights[:, None], y * weights, rcond=None)[0], float)
        errors = np.abs(y - X @ solution)
        weights = np.sqrt(np.minimum(1.0, 2.0 * np.median(errors) / np.maximum(errors, 1e-12)))
    return np.asarray(solution)
