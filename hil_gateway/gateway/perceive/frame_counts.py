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
    empty_ns: int = 0
    """when it has run dry if nothing is added (the virtual scheduling of ITU-T I.371, annex A)"""

    def add(self, now_ns: int) -> None:
        """Count one error."""
        full_ns, empty_ns = now_ns + self.highest * self.leak_ns, self.empty_ns
        empty_ns = (now_ns if empty_ns < now_ns else empty_ns) + self.leak_ns
        self.empty_ns = full_ns if empty_ns > full_ns else empty_ns

    def level(self, now_ns: int) -> int:
        """What is in it at `now_ns`, begun errors counted whole."""
        return max(-((now_ns - self.empty_ns) // self.leak_ns), 0)


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
        self._surplus = {identifier: _surplus(period) for identifier, period in periods.items()}
        self.doubled: set[int] = set()
        """identifiers that more than one sender sends, as of their newest frames"""

    def add(self, identifier: int, now_ns: int) -> None:
        """Count one frame."""
        known = self._surplus.get(identifier)
        if known is None:
            return
        bucket, most_ns = known
        bucket.add(now_ns)
        if bucket.empty_ns - now_ns > most_ns:
            self.doubled.add(identifier)
        elif self.doubled:
            self.doubled.discard(identifier)


def _surplus(period_s: float) -> tuple[LeakyBucket, int]:
    """Of frames with this period, and ns to run dry from which on they are too many."""
    most, leak_ns = max(round(SURPLUS_S / period_s), 5), round(period_s * NS_PER_S / OVER)
    return LeakyBucket(leak_ns, highest=2 * most), (most - 1) * leak_ns
