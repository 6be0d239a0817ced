"""Quantiles of the newest numbers, kept sorted: asking costs nothing, and is done ten times a second."""

from __future__ import annotations

from bisect import bisect_left, insort
from collections import deque


class Rolling:
    """The newest `length` numbers."""

    def __init__(self, length: int) -> None:
        self._length = length
        self._recent: deque[float] = deque()
        self._sorted: list[float] = []

    def add(self, value: float) -> None:
        """Take in a number; the oldest goes when there are too many."""
        if len(self._recent) == self._length:
            self._sorted.pop(bisect_left(self._sorted, self._recent.popleft()))
        self._recent.append(value)
        insort(self._sorted, value)

    def quantile(self, share: float) -> float | None:
        """The number that `share` of them are below; None before the first."""
        return self._sorted[min(int(share * len(self._sorted)), len(self._sorted) - 1)] if self._sorted else None
