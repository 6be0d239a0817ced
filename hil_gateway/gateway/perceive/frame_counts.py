"""Counts of what was received on the wire, and leaky buckets, for wrong counters and second senders."""

from __future__ import annotations

from dataclasses import dataclass


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
