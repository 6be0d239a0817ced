"""Counts of what was received on the wire, a leaky bucket for wrong counters, and second senders."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from hil_gateway.process.clock import NS_PER_S

OVER = 1.4
"""times its declared rate at which a message may come for ever: a sender's clock, and frames that waited somewhere"""
SURPLUS_S = 0.5
"""of declared frames beyond that are a second sender: more than any pause of one delivers afterwards (its deadline)"""


@dataclass(slots=True)
class LeakyBucket:
    """Rises by one an error, falls by one every `leak_ns`; it runs over, so that a flood is not remembered for long."""

    leak_ns: int
    highest: int
    level: int = 0
    _drained_ns: int = 0

    def add(self, now_ns: int) -> None:
        """Count one error."""
        if self.level:
            self.level = min(self.drain(now_ns) + 1, self.highest)
        else:
            self.level, self._drained_ns = 1, now_ns

    def drain(self, now_ns: int) -> int:
        """Level at `now_ns`."""
        if self.level == 0 or now_ns < self._drained_ns:
            self._drained_ns = now_ns
            return self.level
        if leaked := (now_ns - self._drained_ns) // self.leak_ns:
            self.level = max(self.level - leaked, 0)
            self._drained_ns += leaked * self.leak_ns
        return self.level


@dataclass(slots=True)
class FrameCounts:
    """What has been seen on the wire since start."""

    received: int = 0
    lost: int = 0
    unknown: int = 0
    malformed: int = 0
    errors: int = 0
    counter_errors: int = 0
    implausible: int = 0


class Senders:
    """Messages that come more often than one sender sends them."""

    def __init__(self, periods: Mapping[int, float]) -> None:
        """`periods`: identifier -> declared period, s."""
        self._surplus = {
            identifier: (LeakyBucket(round(period * NS_PER_S / OVER), highest=2 * _most(period)), _most(period))
            for identifier, period in periods.items()
        }
        self.doubled: set[int] = set()
        """identifiers that more than one sender sends, as of their newest frames"""

    def add(self, identifier: int, now_ns: int) -> None:
        """Count one frame."""
        known = self._surplus.get(identifier)
        if known is None:
            return
        bucket, most = known
        bucket.add(now_ns)
        if bucket.level >= most:
            self.doubled.add(identifier)
        elif self.doubled:
            self.doubled.discard(identifier)


def _most(period_s: float) -> int:
    return max(round(SURPLUS_S / period_s), 5)
