"""Derivatives of measured signals: a smoothing kernel that differentiates, and what it makes of a derivative itself."""

from __future__ import annotations

import numpy as np

from hil_gateway.process.arrays import Array, Ints


def kernel(step: float, width_s: float) -> tuple[Array, Array]:
    """Smoothing of a derivative by a differentiating Hann kernel of `width_s`, and the kernel, per sample of `step`."""
    half = max(2, round(0.5 * width_s / step))
    at = np.arange(-half, half + 1)
    hann = 1.0 + np.cos(np.pi * at / (half + 1))
    edges = np.concatenate([[0.0], hann, [0.0]])
    slope = 0.5 * (edges[2:] - edges[:-2])
    slope -= slope.mean()
    slope /= -(slope * at).sum() * step
    return _passed(slope * step), slope


def _passed(differences: Array) -> Array:
    """(n,) weights of a derivative at the samples that sum up to what `differences` (n,) take from its integral.

    Between two samples the derivative is a cubic through four: a central difference at 25 Hz is 3 % off the derivative
    in its middle where that turns with 10 rad/s, as yaw does.
    """
    between = np.cumsum(differences)[:-1]
    weights = np.convolve(between, [-1.0, 13.0, 13.0, -1.0]) / 24.0
    inside = weights[1:-1]
    inside[:3] += weights[0] * np.array([3.0, -3.0, 1.0])
    inside[-3:] += weights[-1] * np.array([1.0, -3.0, 3.0])
    return np.asarray(inside, np.float64)


def stretches(rows: Ints, step: float, width_s: float) -> list[Ints]:
    """Uninterrupted runs of row numbers long enough for a kernel of `width_s`."""
    cuts = np.flatnonzero(np.diff(rows) != 1) + 1
    least = 3 * round(width_s / step) + 2
    return [run for run in np.split(rows, cuts) if len(run) > least]
