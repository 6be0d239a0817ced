"""The orderly end of a gateway: one that moves the car stops it first.

Commands that end at once leave the car with its last steering until its own emergency has stopped it.
"""

from __future__ import annotations

import logging

from hil_gateway.gateway.core import Gateway
from hil_gateway.process.clock import NS_PER_S

LONGEST_STOP = 2.0
"""times what the configured deceleration takes from the speed at the request: brakes may be half as good"""
log = logging.getLogger(__name__)


class OrderlyEnd:
    """Asks a gateway to stop the car, and says when its process may end."""

    def __init__(self, gateway: Gateway, deceleration: float) -> None:
        """`deceleration` of a controlled stop, m/s2."""
        self._gateway, self._deceleration = gateway, deceleration
        self._due_ns: int | None = None

    def over(self, now_ns: int, requests: int) -> bool:
        """Whether the process may end before this period, having been asked to `requests` times: the car stands, does
        not obey or is out of reach, or a second request is in a hurry."""
        if requests == 0:
            return False
        if requests > 1 or not self._gateway.moves_car:
            return True
        if self._due_ns is None:
            self._gateway.begin_ending()
            longest_s = LONGEST_STOP * self._gateway.speed / self._deceleration
            self._due_ns = now_ns + round(longest_s * NS_PER_S)
        if now_ns < self._due_ns:
            return False
        log.warning("the gateway ends at %.1f m/s: the stop takes longer than it may", self._gateway.speed)
        return True
