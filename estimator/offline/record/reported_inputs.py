"""Reported inputs: what of their fast part is noise of the measurement, and what the car was really significant.

A command has no noise, a slip measured by wheel speeds has, and through C_x it would count as model error. But a
command may chatter, and the chatter then shows in the acceleration with the same gain as slower commands do.
"""

from __future__ import annotations

import numpy as np

from estimator.drive_log.smoothing import second_difference_noise, wiener
from hil_gateway.process.arrays import Array

NOISY = 0.03
"""Noise of an input relative to its spread from which on it is looked at."""
REAL = 0.5
"""Gain of the acceleration to the fast part of an input, over that to slower parts, above which it is no noise."""
SURE = 2.0
"""Standard errors that gains must be known to: where an acceleration in noise does not tell, it is a command."""
SLOW_S = 0.5
"""Averages over so many seconds are what the gains are significant apart from."""


def without_noise(values: Array, response: Array, step: float) -> Array:
    """An input (n,), smoothed where its fast part is noise; `response` (n,) is the acceleration it acts on,
    with its fast part."""
    if second_difference_noise(values) <= NOISY * float(np.std(values)):
        return values
    smooth = wiener(values, step).value
    (fast, slow), (fast_error, slow_error) = _gains(values - smooth, smooth, response, step)
    significant = abs(slow) > SURE * slow_error
    return smooth if significant and fast / slow + SURE * fast_error / abs(slow) < REAL else values


def _gains(fast: Array, smooth: Array, response: Array, step: float) -> tuple[Array, Array]:
    """Gains (2,) of `response` to `fast` and to what varies within half a second of the smoothed input, and errors."""
    width = max(3, round(SLOW_S / step) | 1)
    window = np.hanning(width + 2)[1:-1] / np.hanning(width + 2).sum()
    inside = slice(width, -width)
    parts = [fast, smooth - np.convolve(smooth, window, "same")]
    X = np.stack([p[inside] for p in parts], axis=1)
    left = (response - np.convolve(response, window, "same"))[inside]
    gains = np.linalg.lstsq(X, left, rcond=None)[0]
    errors = np.std(left - X @ gains) / np.maximum(np.linalg.norm(X, axis=0), 1e-12)
    return np.asarray(gains), np.asarray(errors)
