"""The bus between processes: Zenoh peers with explicit endpoints, no multicast scouting, no router needed.

The gateway listens where the others connect; peers then learn of each other through it and link directly, so
the estimate reaches the planner in one hop. Receiving is pull only: a ring of fixed depth behind every
subscriber, no code of ours in a Zenoh thread. Publishing never waits for a slow reader: what does not
fit is dropped, and the reader sees the gap in the sequence numbers.
"""

from __future__ import annotations

import json
import logging
import os
from pathlib import Path
from typing import Any, Generic, TypeVar

from pydantic import ValidationError

from hil_gateway.bus.messages import Message
from hil_gateway.bus.topics import Topic
from hil_gateway.config import ZenohConfig
from hil_gateway.process.errors import InputError
from hil_gateway.process.lifecycle import worth_a_line
from hil_gateway.text_file import parse_json, read_text

M = TypeVar("M", bound=Message)
log = logging.getLogger(__name__)

HUB = "gateway"
"""Name of the process that listens on the endpoint the others connect to."""
LOOPBACK_HOSTS = ("127.0.0.1", "localhost", "[::1]")
TX_QUEUE_BATCHES = 16
"""batches that wait for a slow reader, Zenoh's most; a message that is sent at once is one of its own"""
HELD_UP_S = 0.1
"""for which a reader may be held up without a loss: topics that fill the queue sooner share batches"""
RUNTIME = "(rx: (worker_threads: 1), acc: (handover: rx), tx: (handover: rx))"
"""One thread serves all links: of the four that Zenoh starts otherwise, three wake one another for every message."""
LARGEST_MESSAGE = 1 << 18
"""bytes; ours have some thousands. Reading one of 20 MB held the gateway up for seconds"""


SENDERS_MAX = 64
"""senders of one topic whose gaps are counted; there is one of most"""
SOON = 20
"""messages within which numbers go back a second time only where two processes send them: one that starts over does so
once"""


class ZenohSubscription(Generic[M]):
    """Newest `depth` messages of one topic; invalid ones are counted and reported, never raised."""

    def __init__(self, session: Any, topic: Topic[M], depth: int) -> None:
        from zenoh.handlers import RingChannel

        self._topic = topic
        self._subscriber = session.declare_subscriber(topic.key, RingChannel(depth))
        self._depth = depth
        self._validate = topic.message.__pydantic_validator__.validate_json
        self._names_sender = "source" in topic.message.model_fields
        self._last: dict[str, tuple[int, int]] = {}
        """by sender: number and stamp of its newest message"""
        self._since_back = SOON
        self.doubled = 0
        """times that messages of two processes met"""
        self.dropped = 0
        self.invalid = 0

    def poll(self, now_ns: int) -> list[M]:
        messages: list[M] = []
        for _ in range(self._depth):  # a sender that is faster than this loop does not hold it up
            if (sample := self._subscriber.try_recv()) is None:
                break
            message = self._parse(sample.payload)
            if message is not None:
                messages.append(message)
        return messages

    def _parse(self, payload: Any) -> M | None:
        if len(payload) > self._topic.max_bytes:
            self._count_invalid(f"{len(payload)} bytes, at most {self._topic.max_bytes}")
            return None
        try:
            message: M = self._validate(payload.to_bytes())
        except ValidationError as error:
            self._count_invalid(error.errors()[0]["msg"])
            return None
        self._count_gap(message)
        return message

    def _count_invalid(self, why: str) -> None:
        self.invalid += 1
        if worth_a_line(self.invalid):
            log.warning("%s: invalid message no. %d: %s", self._topic, self.invalid, why)

    def _count_gap(self, message: M) -> None:
        sender = str(getattr(message, "source", "")) if self._names_sender else ""
        if sender not in self._last and len(self._last) >= SENDERS_MAX:
            return
        last, stamp_ns = self._last.get(sender, (message.seq - 1, 0))
        if (message.seq, message.stamp_ns) == (last, stamp_ns):  # sent again, until it is answered
            return
        if self._topic.rate_hz > 0:  # a person's requests are numbered by the time of asking
            self.dropped += max(message.seq - last - 1, 0)
        self._last[sender] = message.seq, message.stamp_ns
        self._since_back += 1
        if message.seq <= last:
            self._note_back()

    def _note_back(self) -> None:
        """A number that has gone back."""
        if self._since_back <= SOON:
            self.doubled += 1
            if worth_a_line(self.doubled):
                text = "%s: numbers go back and forth, no. %d: do two processes send it?"
                log.warning(text, self._topic, self.doubled)
        self._since_back = 0

    def close(self) -> None:
        """Undeclare the subscriber."""
        self._subscriber.undeclare()


class ZenohBus:
    """`Bus` over one Zenoh session."""

    def __init__(self, session: Any) -> None:
        self._session = session
        self._publishers: dict[str, Any] = {}

    def publish(self, topic: Topic[M], message: M) -> None:
        publisher = self._publishers.get(topic.key) or self._declare(topic)
        publisher.put(message.__pydantic_serializer__.to_json(message))

    def subscribe(self, topic: Topic[M], depth: int = 1) -> ZenohSubscription[M]:
        return ZenohSubscription(self._session, topic, depth)

    def close(self) -> None:
        self._session.close()

    def _declare(self, topic: Topic[Any]) -> Any:
        from zenoh import CongestionControl, Priority

        priority = Priority.REAL_TIME if topic.priority == "real_time" else Priority.DATA
        at_once = topic.rate_hz * HELD_UP_S <= TX_QUEUE_BATCHES
        publisher = self._session.declare_publisher(
            topic.key, priority=priority, congestion_control=CongestionControl.DROP, express=at_once
        )
        self._publishers[topic.key] = publisher
        return publisher


def open_bus(config: ZenohConfig, name: str) -> ZenohBus:
    """Open the session of process `name`; succeeds at once whether or not the others are there yet.

    Raises:
        InputError: busy or unusable endpoint, unreadable or wrong extra file.
    """
    os.environ.setdefault("ZENOH_RUNTIME", RUNTIME)  # read when the first session is opened
    import zenoh

    zenoh.init_log_from_env_or("error,zenoh::api::session=off")  # which reports every message that comes while closing
    tree = session_config(config, name)
    try:
        return ZenohBus(zenoh.open(zenoh.Config.from_json5(json.dumps(tree))))
    except zenoh.ZError as error:
        raise InputError(_explain(str(error), tree)) from None


def session_config(config: ZenohConfig, name: str) -> dict[str, Any]:
    """Zenoh configuration tree of process `name`: ours, with the user's extra file merged over it."""
    client = config.mode == "client"
    connect = () if name == HUB and not client else config.connect
    tree: dict[str, Any] = {
        "mode": config.mode,
        "metadata": {"name": name},
        "listen": {"endpoints": list(_listen_endpoints(config, name)), "exit_on_failure": True},
        "connect": {
            "endpoints": list(connect),
            "timeout_ms": 0 if client else -1,  # a client is nothing without its router, a peer waits for the others
            "exit_on_failure": client,
            "retry": {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 1.5},
        },
        "open": {"return_conditions": {"connect_scouted": False}},
        # gossip only tells connected peers of each other; nothing is sent to addresses not configured
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": True}},
        "transport": {
            "shared_memory": {"enabled": False},
            "link": {
                "rx": {"max_message_size": LARGEST_MESSAGE},
                "tx": {
                    "queue": {
                        "size": dict.fromkeys(("real_time", "data"), TX_QUEUE_BATCHES),
                        "congestion_control": {"drop": {"wait_before_drop": 0}},
                    }
                },
            },
        },
    }
    return with_extra(tree, config.extra)


def with_extra(tree: dict[str, Any], path: str) -> dict[str, Any]:
    """A Zenoh configuration with the user's file merged over it; an empty path leaves it as it is.

    Raises:
        InputError: unreadable, or no Zenoh configuration.
    """
    return _merge(tree, _read_extra(path)) if path else tree


def _listen_endpoints(config: ZenohConfig, name: str) -> tuple[str, ...]:
    """Explicit ones, else the hub's own; the other processes listen on a free port of the same loopback."""
    if config.listen or not config.connect or config.mode == "client":
        return config.listen
    first = config.connect[0]
    if name == HUB:
        return (first,)
    protocol, _, address = first.partition("/")
    host = address.rpartition(":")[0]
    return (f"{protocol}/{host}:0",) if host in LOOPBACK_HOSTS else ()


def _read_extra(path: str) -> dict[str, Any]:
    import zenoh

    tree = read_json5(Path(path))
    try:
        zenoh.Config.from_json5(json.dumps(tree))
    except zenoh.ZError as error:
        raise InputError(f"{path}: not a Zenoh configuration (zenoh.extra): {error}") from None
    return tree


def read_json5(path: Path) -> dict[str, Any]:
    """Tree of a file that uses nothing of JSON5 but `//` comment lines.

    Raises:
        InputError: unreadable, or not that.
    """
    text = read_text(path, "Zenoh configuration (zenoh.extra)")
    lines = (line for line in text.splitlines() if not line.lstrip().startswith("//"))
    try:
        tree = parse_json(path, "\n".join(lines))
    except InputError as error:
        raise InputError(f"{error} (zenoh.extra is JSON with // comment lines)") from None
    if not isinstance(tree, dict):
        raise InputError(f"{path}: must hold one JSON object (zenoh.extra)")
    return tree


def _merge(base: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    """`over` wins; tables are merged, everything else is replaced."""
    merged = dict(base)
    for key, value in over.items():
        old = merged.get(key)
        merged[key] = _merge(old, value) if isinstance(old, dict) and isinstance(value, dict) else value
    return merged


def _explain(text: str, tree: dict[str, Any]) -> str:
    listen, connect = (", ".join(tree[side]["endpoints"]) or "nothing" for side in ("listen", "connect"))
    if "in use" in text:
        return f"{listen}: the port is busy (zenoh.listen); stop the other gateway or choose another endpoint"
    if tree["mode"] == "client":
        return f"no Zenoh router at {connect} (zenoh.connect); start zenohd there, or set zenoh.mode to peer"
    reason = text.partition(" at /")[0]
    return f"cannot open Zenoh: zenoh.listen is {listen}, zenoh.connect is {connect}: {reason}"
