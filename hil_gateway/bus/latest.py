"""The newest value of one topic, with what a reader needs to know before trusting it."""

from __future__ import annotations

from typing import Generic, TypeVar

from hil_gateway.bus.messages import Message
from hil_gateway.process.clock import NS_PER_S

M = TypeVar("M", bound=Message)


class Latest(Generic[M]):
    """Holds the newest message and its time of receipt, by the reader's own clock."""

    def __init__(self, deadline_s: float) -> None:
        self.deadline_s = deadline_s
        self.message: M | None = None
        self.received_ns: int | None = None
        self.count = 0

    def put(self, message: M, now_ns: int) -> None:
        """Store a message received at `now_ns`."""
        self.message = message
        self.received_ns = now_ns
        self.count += 1

    def age_s(self, now_ns: int) -> float:
        """Seconds since receipt; infinite before the first message."""
        if self.received_ns is None:
            return float("inf")
        return (now_ns - self.received_ns) / NS_PER_S

    def alive(self, now_ns: int) -> bool:
        """Whether the newest message is younger than the topic's deadline."""
        return self.age_s(now_ns) <= self.deadline_s

    def valid(self, now_ns: int) -> bool:
        """Alive, and the sender itself calls the content valid (messages without such a flag count as valid)."""
        return self.alive(now_ns) and bool(getattr(self.message, "valid", True))
