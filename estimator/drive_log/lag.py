"""Time offset between two records of the same motion: the lag of the largest correlation, by parts of the log."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil_gateway.process.arrays import Array

PARTS = 10
"""Parts of the log the lag is estimated on separately, for its standard deviation."""


@dataclass(frozen=True)
class Lag:
    """`later` follows `earlier` by `value` +- `std` seconds, with the given correlation there and gain."""

    value: float
    std: float
    correlation: float
    gain: float


def lag_between(  # noqa: PLR0917 - a signal pair, where it counts, and three times
    earlier: Array, later: Array, usable: NDArray[np.bool_], step: float, longest: float, slowest: float = 2.0
) -> Lag | None:
    """Lag of `later` (n,) behind `earlier` (n,) up to `longest` seconds either way; None without a clear answer.

    Motion slower than `slowest` times the longest lag is taken out first: drift tells no time.
    """
    reach = max(2, round(longest / step))
    if usable.sum() < 20 * reach:
        return None
    a, b = (np.where(usable, fast_part(x, round(slowest * reach)), 0.0) for x in (earlier, later))
    edges = np.linspace(0, len(a), PARTS + 1).astype(int)
    sums = np.stack([_cross_sums(a[i:j], b[i:j], reach) for i, j in itertools.pairwise(edges)])
    whole = sums.sum(axis=0)
    scale = np.sqrt(float(a @ a) * float(b @ b))
    if scale <= 0.0:
        return None
    value, peak = _peak(whole)
    parts = [_peak(whole - part)[0] for part in sums]  # jackknife: each part left out in turn
    std = float(np.sqrt((PARTS - 1) / PARTS * np.sum((np.array(parts) - np.mean(parts)) ** 2)))
    return Lag((value - reach) * step, max(std, 0.02) * step, peak / scale, peak / float(a @ a))


def fast_part(values: Array, window: int) -> Array:
    """(n,) values minus their moving average over `window` samples."""
    total = np.concatenate([[0.0], np.cumsum(np.pad(values, (window // 2, window - window // 2), mode="edge"))])
    return np.asarray(values - ((total[window:] - total[:-window]) / window)[: len(values)])


def _cross_sums(a: Array, b: Array, reach: int) -> Array:
    """Sums of a(t) b(t + k) for k = -reach .. reach."""
    n = len(a)
    size = 1 << int(np.ceil(np.log2(n + reach + 1)))
    product = np.fft.irfft(np.conj(np.fft.rfft(a, size)) * np.fft.rfft(b, size), size)
    return np.concatenate([product[-reach:], product[: reach + 1]])


def _peak(sums: Array) -> tuple[float, float]:
    """Position and height of the maximum, refined by a parabola."""
    i = int(np.argmax(sums))
    if i in (0, len(sums) - 1):
        return float(i), float(sums[i])
    left, top, right = sums[i - 1 : i + 2]
    shift = 0.5 * (left - right) / (left - 2.0 * top + right)
    return i + float(shift), float(top)
