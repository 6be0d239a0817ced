"""Counts of what was received on the wire, and a bucket that forgives a rare wrong counter."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class LeakyBucket:
    """Rises by one an error, falls by one every `leak_ns`; it runs over, so that a flood is not remembered for long."""

    leak_ns: int
    highest: int
    level: int = 0
    _drained_ns: int = 0

    def add(self, now_ns: int) -> None:
        """Count one error."""
        self.drain(now_ns)
        self.level = min(self.level + 1, self.highest)

    def drain(self, now_ns: int) -> int:
        """Level at `now_ns`."""
        if self.level == 0 or now_ns < self._drained_ns:
            self._drained_ns = now_ns
            return self.level
        leaked = (now_ns - self._drained_ns) // self.leak_ns
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
