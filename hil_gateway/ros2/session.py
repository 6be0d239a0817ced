"""The bridge's node in the ROS graph: one Zenoh session with its tokens, publishers and subscriptions.

Receiving is pull only, through rings of fixed depth; publishing never waits for a slow reader.
"""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from typing import Any, Protocol

from hil_gateway.bus.zenoh_bus import LARGEST_MESSAGE, TX_QUEUE_BATCHES, with_extra
from hil_gateway.process.errors import InputError
from hil_gateway.ros2.graph import TOKENS_MAX
from hil_gateway.ros2.topics import NODE, RosTopic
from hil_gateway.ros2.types import Types
from hil_gateway.ros2.wire import ADMIN_SPACE, Attachment, Kind, Node, data_key, gid, parse_token, unpack_attachment
from hil_gateway.settings.ros2 import Ros2Config

COMMAND_DEPTH = 16
"""unread messages of one command topic: 0.16 s at 100 Hz"""
MESSAGE_BYTES_MAX = 1024
"""of a command; the longest is a stamped one with the name of its frame"""
SETTLE_S = 1.0
"""until the tokens of those that are there have arrived"""
HEARTBEAT_S = 0.5
"""as `rmw_zenoh` for topics that keep their last message"""


@dataclass(frozen=True, slots=True)
class ReceivedSample:
    """A message of a command topic; `attachment` is None where it has another form than expected."""

    topic: RosTopic
    data: bytes
    attachment: Attachment | None


class RosNode(Protocol):
    """The ROS side as the bridge sees it."""

    session: str
    """Zenoh identifier"""

    def wanted(self, topic: RosTopic) -> bool:
        """Whether anybody subscribes."""
        ...

    def publish(self, topic: RosTopic, data: bytes, unix_ns: int) -> None:
        """Send one message, published at `unix_ns`."""
        ...

    def received(self) -> list[ReceivedSample]:
        """Commands since the last call, oldest first within a topic."""
        ...

    def graph_changes(self) -> list[tuple[str, bool]]:
        """Tokens that appeared (True) or vanished since the last call."""
        ...


class ZenohRosNode:
    """`RosNode` over one Zenoh session."""

    def __init__(self, config: Ros2Config, types: Types) -> None:
        """Raises:
        InputError: no router there (client), the port is in use (router), unusable endpoint or extra file.
        """
        self._config, self._types = config, types
        self._session = _open(config)
        self.session = str(self._session.zid())
        self._node = Node(config.domain, self.session, NODE)
        self._tokens: list[Any] = []
        self._publishers: dict[RosTopic, _Publisher] = {}
        self._subscribers: list[tuple[RosTopic, Any]] = []
        self._graph = self._watch()
        self._early: list[tuple[str, bool]] = []

    def join(self) -> None:
        """Appear in the graph, once the tokens of those that are there have had time to arrive.

        Raises:
            InputError: a bridge is there already.
        """
        deadline = time.monotonic() + SETTLE_S
        while time.monotonic() < deadline:
            time.sleep(SETTLE_S / 20)
            self._early += self._changes()
            for token in (parse_token(text) for text, _ in self._early):
                if token is not None and token.kind == Kind.NODE and token.node == f"/{NODE}":
                    where = f"ROS domain {self._config.domain}"
                    raise InputError(f"{where} has a bridge already (session {token.session}): stop that one")
        self._tokens.append(self._declare(self._node.token))

    def advertise(self, topic: RosTopic) -> None:
        """Declare a publisher and its token."""
        of = self._types.of(topic.type)
        token = self._node.endpoint_token(len(self._tokens), Kind.PUBLISHER, topic.name, of, topic.qos)
        key = data_key(self._config.domain, topic.name, of)
        self._publishers[topic] = _Publisher(_declare_publisher(self._session, key, topic), gid(token))
        self._tokens.append(self._declare(token))

    def subscribe(self, topic: RosTopic) -> None:
        """Declare a subscription and its token."""
        from zenoh.handlers import RingChannel

        of = self._types.of(topic.type)
        key = data_key(self._config.domain, topic.name, of)
        self._subscribers.append((topic, self._session.declare_subscriber(key, RingChannel(COMMAND_DEPTH))))
        token = self._node.endpoint_token(len(self._tokens), Kind.SUBSCRIPTION, topic.name, of, topic.qos)
        self._tokens.append(self._declare(token))

    def wanted(self, topic: RosTopic) -> bool:
        publisher = self._publishers.get(topic)
        return publisher is not None and publisher.wanted

    def publish(self, topic: RosTopic, data: bytes, unix_ns: int) -> None:
        self._publishers[topic].put(data, unix_ns)

    def received(self) -> list[ReceivedSample]:
        found = []
        for topic, subscriber in self._subscribers:
            for _ in range(COMMAND_DEPTH):  # a sender that is faster than this loop does not hold it up
                if (sample := subscriber.try_recv()) is None:
                    break
                found.append(_received(topic, sample))
        return found

    def graph_changes(self) -> list[tuple[str, bool]]:
        early, self._early = self._early, []
        return early + self._changes()

    def _changes(self) -> list[tuple[str, bool]]:
        from zenoh import SampleKind

        changes = []
        for _ in range(TOKENS_MAX):
            if (sample := self._graph.try_recv()) is None:
                break
            changes.append((str(sample.key_expr), sample.kind == SampleKind.PUT))
        return changes

    def close(self) -> None:
        """Leave the graph; a session that is left open keeps the process alive."""
        self._session.close()

    def _declare(self, token: str) -> Any:
        return self._session.liveliness().declare_token(token)

    def _watch(self) -> Any:
        from zenoh.handlers import RingChannel

        pattern = f"{ADMIN_SPACE}/{self._config.domain}/**"
        return self._session.liveliness().declare_subscriber(pattern, RingChannel(TOKENS_MAX), history=True)


@dataclass(slots=True)
class _Publisher:
    """A Zenoh publisher with what its attachments need."""

    publisher: Any
    gid: bytes
    sequence: int = 0

    @property
    def wanted(self) -> bool:
        return bool(self.publisher.matching_status.matching)

    def put(self, data: bytes, unix_ns: int) -> None:
        self.sequence += 1
        self.publisher.put(data, attachment=Attachment(self.sequence, unix_ns, self.gid).packed())


def _declare_publisher(session: Any, key: str, topic: RosTopic) -> Any:
    from zenoh import CongestionControl, Reliability, ext

    settings: Any = {
        "congestion_control": CongestionControl.DROP,
        "reliability": Reliability.BEST_EFFORT if topic.qos.best_effort else Reliability.RELIABLE,
        "express": topic.qos.depth <= TX_QUEUE_BATCHES,  # what comes in bursts shares batches: else it fills the queue
    }
    if not topic.qos.transient_local:
        return session.declare_publisher(key, **settings)
    settings["cache"] = ext.CacheConfig(topic.qos.depth)
    settings["sample_miss_detection"] = ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=HEARTBEAT_S)
    return ext.declare_advanced_publisher(session, key, **settings, publisher_detection=True)


def _received(topic: RosTopic, sample: Any) -> ReceivedSample:
    data = sample.payload.to_bytes() if len(sample.payload) <= MESSAGE_BYTES_MAX else b""
    attachment = sample.attachment
    return ReceivedSample(topic, data, None if attachment is None else unpack_attachment(attachment.to_bytes()))


def session_config(config: Ros2Config) -> dict[str, Any]:
    """Zenoh configuration of the ROS side: as `rmw_zenoh`'s own sessions, or its router's."""
    router, client = config.mode == "router", config.mode == "client"
    listen = config.listen or (config.connect if router else () if client else ("tcp/localhost:0",))
    tree: dict[str, Any] = {
        "mode": config.mode,
        "metadata": {"name": NODE},
        "listen": {"endpoints": list(listen), "exit_on_failure": True},
        "connect": {
            "endpoints": [] if router else list(config.connect),
            "timeout_ms": 0 if client else -1,
            "exit_on_failure": client,
            "retry": {"period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 2},
        },
        "open": {"return_conditions": {"connect_scouted": False}},
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": True}},
        "timestamping": {"enabled": True},  # late subscribers are given what they miss by its time
    }
    if not router:  # which passes on whatever the nodes send each other, pictures too
        tree["transport"] = {"link": {"rx": {"max_message_size": LARGEST_MESSAGE}}}
    return with_extra(tree, config.extra)


def _open(config: Ros2Config) -> Any:
    import zenoh

    zenoh.init_log_from_env_or("error,zenoh::api::session=off")
    try:
        return zenoh.open(zenoh.Config.from_json5(json.dumps(session_config(config))))
    except zenoh.ZError as error:
        raise InputError(_explain(config, str(error))) from None


def _explain(config: Ros2Config, reason: str) -> str:
    where = ", ".join(config.listen or config.connect)
    if "in use" in reason:
        return f"{where}: the port is busy (ros2.listen): does rmw_zenohd run? then ros2.mode is peer"
    if config.mode == "client":
        return f"no router at {where} (ros2.connect): start `ros2 run rmw_zenoh_cpp rmw_zenohd`, or ros2.mode router"
    return f"cannot open Zenoh at {where} (ros2.connect, ros2.listen): {reason.partition(' at /')[0]}"
