"""Core of the bridge: the car's state out to ROS, and what keeps nodes and bridge apart. Time is an argument."""

from __future__ import annotations

import logging

from hil_gateway.bus import topics
from hil_gateway.bus.interface import Bus
from hil_gateway.bus.outside import Ros2Status
from hil_gateway.can_link import CanLink
from hil_gateway.config import Config
from hil_gateway.process.lifecycle import worth_a_line
from hil_gateway.ros2 import topics as ros
from hil_gateway.ros2.graph import NAMES_MAX, Graph
from hil_gateway.ros2.incoming import Incoming
from hil_gateway.ros2.outgoing import Level, Status
from hil_gateway.ros2.publishing import Publishing
from hil_gateway.ros2.session import RosNode
from hil_gateway.ros2.topics import RosTopic
from hil_gateway.ros2.types import Types

NOTES_MAX = 16
log = logging.getLogger(__name__)


def published_topics(config: Config) -> tuple[RosTopic, ...]:
    """What the bridge publishes."""
    return (*ros.STATE, *((ros.FRAMES,) if config.ros2.frames else ()))


def taken_topics(config: Config) -> tuple[RosTopic, ...]:
    """Command topics that are listened to."""
    return ros.COMMANDS[config.ros2.commands]


class Bridge:
    """`step` once a millisecond."""

    def __init__(self, config: Config, bus: Bus, link: CanLink, types: Types, node: RosNode) -> None:
        self._bus, self._link, self._node = bus, link, node
        self._publishing = Publishing(bus, config.vehicle, types, node)
        taken, published = ([(t.name, types.of(t.type)) for t in f(config)] for f in (taken_topics, published_topics))
        self.graph = Graph(node.session, taken, published)
        self._incoming = Incoming(config, types, node.session, self.graph.sender)
        self._notes: tuple[str, ...] = ()
        self._status_ns = self._seq = 0

    def step(self, now_ns: int, unix_offset_ns: int) -> None:
        """Pass on what has arrived; `unix_offset_ns` turns monotonic stamps into Unix time."""
        self._watch_graph()
        self._publishing.step(now_ns, unix_offset_ns, self._link.receive(0.0), (self._diagnosis(),))
        self._take_commands(now_ns, unix_offset_ns)
        if now_ns >= self._status_ns:
            self._status_ns = now_ns + topics.ROS2_STATUS.period_ns
            self._bus.publish(topics.ROS2_STATUS, self._status(now_ns))

    def _take_commands(self, now_ns: int, unix_offset_ns: int) -> None:
        """At most one command a step, of the newest messages; each reason to refuse is logged ever more rarely."""
        fresh = False
        for received in self._node.received():
            reason = self._incoming.take(received, now_ns, unix_offset_ns)
            fresh = fresh or not reason
            if reason and worth_a_line(self._incoming.refused[reason]):
                log.warning("command not taken, no. %d: %s", self._incoming.refused[reason], reason)
        command = self._incoming.command(now_ns, self._publishing.state.message) if fresh else None
        if command is not None:
            self._bus.publish(topics.ROS2_COMMAND, command)

    def _watch_graph(self) -> None:
        """Log what is new of the notes."""
        changes = self._node.graph_changes()
        for token, appeared in changes:
            self.graph.change(token, appeared)
        if not changes:
            return
        before, self._notes = self._notes, self.graph.notes
        for note in self._notes:
            if note not in before:
                log.warning("%s", note)

    def _diagnosis(self) -> Status:
        notes = self._notes[:NOTES_MAX]
        return (
            "av24: ros2",
            Level.WARN if notes else Level.OK,
            notes[0] if notes else "no type differs",
            [("note", n) for n in notes],
        )

    def _status(self, now_ns: int) -> Ros2Status:
        self._seq += 1
        return Ros2Status(
            stamp_ns=now_ns,
            seq=self._seq - 1,
            session=self._node.session,
            nodes=self.graph.nodes,
            sent=self._publishing.sent,
            taken=self._incoming.taken,
            refused={reason[:NAMES_MAX]: count for reason, count in self._incoming.refused.items()},
            notes=self._notes[:NOTES_MAX],
        )
