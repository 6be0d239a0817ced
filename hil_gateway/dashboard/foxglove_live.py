"""The running car for Foxglove: every topic of ours and the `foxglove.*` ones over its WebSocket protocol.

The server of the `foxglove-sdk` package sends only: it offers clients nothing to publish, call or set.
"""

from __future__ import annotations

import time
from typing import Any

from hil_gateway.bus.interface import Bus
from hil_gateway.bus.topics import TOPICS, TRUTH
from hil_gateway.config import Config
from hil_gateway.process.clock import NS_PER_S, Clock
from hil_gateway.process.errors import InputError
from hil_gateway.session.exchange.foxglove import CHANNELS, FoxgloveMaker
from hil_gateway.session.exchange.foxglove_schemas import schema_text
from hil_gateway.session.files.format import json_schema
from hil_gateway.track.geodesy import LocalMap
from hil_gateway.track.track import Track

DEPTH = 64
"""messages of a topic between two steps"""
SCENERY_NS = 5 * NS_PER_S
"""track and car are said again this often, for who comes late"""
PERIOD_S = 0.02


class FoxgloveLive:
    """Passes what is on the bus on to Foxglove's server."""

    def __init__(self, bus: Bus, track: Track, config: Config, host: str, port: int) -> None:
        """Serve on `host` and `port`, TCP; 0 is a free port.

        Raises:
            InputError: the package is missing, or the port is not to be had.
        """
        try:
            import foxglove
        except ImportError:
            raise InputError("Foxglove needs the package foxglove-sdk; install hil-gateway[foxglove]") from None
        shown = [topic for topic in TOPICS if topic is not TRUTH]
        self._queues = {topic.key: bus.subscribe(topic, depth=DEPTH) for topic in shown}
        self._maker = FoxgloveMaker(track, LocalMap(config.origin))
        self._context = context = foxglove.Context()  # channels of a context that is gone are closed
        schemas = {topic.key: (topic.message.__name__, json_schema(topic.message)) for topic in shown}
        schemas |= {topic: (name, schema_text(name)) for topic, name in CHANNELS.items()}
        self._channels: dict[str, Any] = {
            topic: foxglove.Channel(
                topic, context=context, message_encoding="json",
                schema=foxglove.Schema(name=name, encoding="jsonschema", data=text),
            )
            for topic, (name, text) in schemas.items()
        }  # fmt: skip
        self._scenery_ns = 0
        try:
            self._server = foxglove.start_server(name="AV-24", host=host, port=port, context=context)
        except (RuntimeError, OSError) as error:
            raise InputError(f"foxglove: cannot listen on {host}:{port}: {error}; choose another --port") from None

    @property
    def port(self) -> int:
        """TCP port it listens on."""
        return int(self._server.port)

    def step(self, now_ns: int, unix_ns: int) -> None:
        """Pass on what has arrived; `now_ns` is monotonic, `unix_ns` wall time."""
        if now_ns >= self._scenery_ns:
            self._scenery_ns = now_ns + SCENERY_NS
            self._send(*self._maker.scenery(unix_ns), unix_ns)
        for topic, queue in self._queues.items():
            for message in queue.poll(now_ns):
                self._send(topic, message.model_dump_json().encode(), unix_ns)
                for name, data in self._maker.of(topic, message, unix_ns):
                    self._send(name, data, unix_ns)

    def _send(self, topic: str, data: bytes, unix_ns: int) -> None:
        self._channels[topic].log(data, log_time=unix_ns)

    def close(self) -> None:
        """Hang up on every client."""
        self._server.stop()


def run(live: FoxgloveLive, clock: Clock) -> None:
    """Until interrupted."""
    try:
        while True:
            now_ns = clock.now_ns()
            live.step(now_ns, time.time_ns())
            clock.sleep_until(now_ns + round(PERIOD_S * NS_PER_S))
    except KeyboardInterrupt:
        pass
    finally:
        live.close()
