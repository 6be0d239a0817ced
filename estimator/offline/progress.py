"""How far a computation is whose number of steps nobody knows."""

from __future__ import annotations


def approached(first: float, last: float, steps: int, halfway: int) -> float:
    """Share of the whole between `first` and `last` after so many `steps`; half of the way after `halfway` of them.

    It slows down where there are many, but never stands still: after three times `halfway` a quarter is left.
    """
    return first + (last - first) * steps / (steps + halfway)
