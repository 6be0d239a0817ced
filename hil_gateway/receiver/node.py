"""Receiver process: all receivers of the configuration, read as bytes arrive.

It runs on the gateway's computer: its stamps are of that computer's monotonic clock.
"""

from __future__ import annotations

import select

from hil_gateway.bus.zenoh_bus import open_bus
from hil_gateway.config import Config
from hil_gateway.process.clock import NS_PER_S, SystemClock, wall_offset_ns
from hil_gateway.process.errors import InputError
from hil_gateway.process.lifecycle import StopRequest
from hil_gateway.process.scheduling import punctual
from hil_gateway.receiver.core import Receivers
from hil_gateway.receiver.reader import Reader
from hil_gateway.receiver.source import Stream
from hil_gateway.settings.receivers import ReceiverConfig

WAIT_S = 0.01
SILENT_NS = 3 * NS_PER_S
"""without a byte, after which a connection is taken for dead: a cable that was pulled says nothing"""
AGAIN_NS = NS_PER_S // 2
"""between two attempts to connect"""


class Connection:
    """One receiver's stream, opened again whenever it ends."""

    def __init__(self, config: ReceiverConfig, reader: Reader) -> None:
        self._config, self._reader = config, reader
        self.stream: Stream | None = None
        self._next_ns = self._heard_ns = 0
        self._speaks = False

    def open(self, now_ns: int) -> None:
        """Connect where it is time to; end a stream that says nothing."""
        if self.stream is not None and now_ns - self._heard_ns > SILENT_NS:
            self._end(now_ns, f"no byte from {self._config.address} for {SILENT_NS // NS_PER_S} s")
        if self.stream is not None or now_ns < self._next_ns:
            return
        try:
            self.stream, self._heard_ns, self._speaks = Stream(self._config.address, self._config.baud), now_ns, False
        except (OSError, ValueError, OverflowError) as error:
            self._end(now_ns, f"{self._config.address}: {getattr(error, 'strerror', None) or error}")

    def read(self, now_ns: int) -> bytes:
        """What has arrived."""
        assert self.stream is not None
        try:
            data = self.stream.read()
        except OSError as error:
            self._end(now_ns, f"{self._config.address}: {error.strerror or error}")
            return b""
        if data is None:
            self._end(now_ns, f"{self._config.address} has ended the connection")
            return b""
        if data and not self._speaks:
            self._speaks = True
            self._reader.begin()
        self._heard_ns = now_ns if data else self._heard_ns
        return data

    def _end(self, now_ns: int, why: str) -> None:
        self.close()
        self._reader.broken, self._next_ns = why, now_ns + AGAIN_NS

    def close(self) -> None:
        """End the stream."""
        if self.stream is not None:
            self.stream.close()
            self.stream = None


def run(config: Config) -> None:
    """Run until SIGINT or SIGTERM.

    Raises:
        InputError: no receiver is configured.
    """
    if not config.receivers:
        known = ", ".join(config.car.network_receivers) or "none: add one to its car.toml"
        raise InputError(f"no receiver is configured: [receivers.NAME] needs an address; names are {known}")
    stopped, clock = StopRequest(), SystemClock()
    bus = open_bus(config.zenoh, "receiver")
    receivers = Receivers(config, bus)
    connections = {name: Connection(given, receivers.readers[name]) for name, given in config.receivers.items()}
    punctual("receiver")
    try:
        while not stopped():
            _step(connections, receivers, clock)
    finally:
        for connection in connections.values():
            connection.close()
        bus.close()


def _step(connections: dict[str, Connection], receivers: Receivers, clock: SystemClock) -> None:
    for connection in connections.values():
        connection.open(clock.now_ns())
    opened = {c.stream: name for name, c in connections.items() if c.stream is not None}
    ready = select.select([*opened], [], [], WAIT_S)[0]
    now_ns = clock.now_ns()
    arrived = {opened[stream]: connections[opened[stream]].read(now_ns) for stream in ready}
    receivers.take({name: data for name, data in arrived.items() if data}, now_ns, wall_offset_ns())
    receivers.step(now_ns)
