"""All receivers of the configuration: what arrives, to the bus; and how they are. Time is an argument."""

from __future__ import annotations

import logging
from collections.abc import Mapping

from hil_gateway.bus import topics
from hil_gateway.bus.interface import Bus
from hil_gateway.bus.outside import ReceiverStatus
from hil_gateway.config import Config
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.receiver.reader import Reader

STATUS_NS = NS_PER_S
SOONEST_NS = NS_PER_S // 10
"""between two statuses, whatever changes"""
log = logging.getLogger(__name__)


class Receivers:
    """`take` and `broke` as streams go; `step` once in a while."""

    def __init__(self, config: Config, bus: Bus) -> None:
        self._bus, declared = bus, config.car.network_receivers
        self.readers = {name: Reader(name, given, declared[name]) for name, given in config.receivers.items()}
        self._causes: dict[str, str] = {}
        self._status_ns = self._seq = 0

    def take(self, arrived: Mapping[str, bytes], now_ns: int, unix_offset_ns: int) -> None:
        """Publish what these bytes complete, by name of receiver."""
        for name, data in arrived.items():
            for message in self.readers[name].take(data, now_ns, unix_offset_ns):
                self._bus.publish(topics.NAVIGATION, message)

    def step(self, now_ns: int) -> None:
        """Say how the receivers are: every second, and soon after a cause has changed."""
        causes = {name: reader.cause(now_ns) for name, reader in self.readers.items()}
        since_ns = now_ns - self._status_ns
        if since_ns < STATUS_NS and not (causes != self._causes and since_ns >= SOONEST_NS):
            return
        for name, cause in causes.items():
            if cause != self._causes.get(name, ""):
                log.warning("%s: %s", name, cause or "places the car")
        self._causes, self._status_ns = causes, now_ns
        health = {name: reader.health(now_ns) for name, reader in self.readers.items()}
        self._bus.publish(topics.RECEIVER_STATUS, ReceiverStatus(stamp_ns=now_ns, seq=self._seq, receivers=health))
        self._seq += 1
