"""How long something has held."""

from __future__ import annotations

from hil_gateway.process.clock import NS_PER_S

UNSEEN_S = 0.5
"""s after which what was held up begins anew: a yaw rate that changes by 0.1 rad/s2 is 12 mrad off then"""
JITTER_S = 0.03
"""three periods, by which anything may come late, or early"""
SILENT_S = 0.05
"""five periods of the fastest reports: nothing of them is a silence"""
CONTRADICTED_S = 0.1
"""two fixes at 20 Hz, or readings of other receivers at 10 Hz: what contradicts for longer is no single wrong one"""
NAMED_S = 1.0
"""for which somebody counts as there who has sent what is not his to send"""


class ConditionTime:
    """How long a condition has held, s, as far as it was seen to."""

    def __init__(self) -> None:
        self._since_ns: int | None = None
        self._seen_ns = 0

    def update(self, holds: bool, now_ns: int) -> float:
        """0 while it does not hold."""
        if not holds:
            self._since_ns = None
            return 0.0
        if self._since_ns is None or now_ns - self._seen_ns > UNSEEN_S * NS_PER_S:
            self._since_ns = now_ns
        self._seen_ns = now_ns
        return (now_ns - self._since_ns) / NS_PER_S


class Comparison:
    """How long what sources differ by has been beyond its bound."""

    def __init__(self) -> None:
        self.share = 0.0
        """of the bound, in the newest period"""
        self._beyond = ConditionTime()

    def update(self, share: float, now_ns: int) -> float:
        """s; once a period."""
        self.share = share
        return self._beyond.update(share > 1.0, now_ns)
