"""How long something has held."""

from __future__ import annotations

from hil_gateway.process.clock import NS_PER_S


class ConditionTime:
    """How long a condition has held, s."""

    def __init__(self) -> None:
        self._since_ns: int | None = None

    def update(self, holds: bool, now_ns: int) -> float:
        """0 while it does not hold."""
        if not holds:
            self._since_ns = None
            return 0.0
        if self._since_ns is None:
            self._since_ns = now_ns
        return (now_ns - self._since_ns) / NS_PER_S
