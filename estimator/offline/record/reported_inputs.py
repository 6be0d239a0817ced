"""Reported inputs: what of their fast part is noise of the measurement, and what the car was really told.

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
SLOW_S = 0.5
"""Averages over so many seconds are what the gains are told apart from."""


def without_noise(values: Array, response: Array, step: float) -> Array:
    """An input (n,), smoothed where its fast part is noise; `response` (n,) is the acceleration it acts on."""
    if second_difference_noise(values) <= NOISY * float(np.std(values)):
        return values
    smooth = wiener(values, step).value
    return values if _fast_gain(values - smooth, smooth, response, step) > REAL else smooth


def _fast_gain(fast: Array, smooth: Array, response: Array, step: float) -> float:
    """Gain of `response` to `fast` relative to that to what varies within half a second of the smoothed input."""
    width = max(3, round(SLOW_S / step) | 1)
    window = np.hanning(width + 2)[1:-1] / np.hanning(width + 2).sum()
    inside = slice(width, -width)
    parts = [fast, smooth - np.convolve(smooth, window, "same")]
    left = response - np.convolve(response, window, "same")
    gains = np.linalg.lstsq(np.stack([p[inside] for p in parts], axis=1), left[inside], rcond=None)[0]
    return float(gains[0] / gains[1]) if gains[1] != 0.0 else 0.0
