"""Bridge process: the core on the system clock, woken by frames and at least once a millisecond."""

from __future__ import annotations

from hil_gateway.bus.zenoh_bus import open_bus
from hil_gateway.can_link import open_link
from hil_gateway.config import Config
from hil_gateway.process.clock import NS_PER_S, SystemClock, wall_offset_ns
from hil_gateway.process.lifecycle import StopRequest
from hil_gateway.ros2.bridge import Bridge, published_topics, taken_topics
from hil_gateway.ros2.session import ZenohRosNode
from hil_gateway.ros2.types import Types

PERIOD_NS = NS_PER_S // 1000


def run(config: Config) -> None:
    """Run until SIGINT or SIGTERM.

    Raises:
        InputError: no such CAN interface, unusable endpoint, another bridge in the domain.
    """
    stopped, clock = StopRequest(), SystemClock()
    types = Types(config.ros2.messages, hashes=config.ros2.type_hashes)
    node = ZenohRosNode(config.ros2, types)
    try:
        node.join()
        link, bus = open_link(config.can), open_bus(config.zenoh, "ros2")
        for topic in published_topics(config):
            node.advertise(topic)
        for topic in taken_topics(config):
            node.subscribe(topic)
        bridge = Bridge(config, bus, link, types, node)
        while not stopped():
            now_ns = clock.now_ns()
            bridge.step(now_ns, wall_offset_ns())
            clock.sleep_until(now_ns + PERIOD_NS)
        link.close()
        bus.close()
    finally:
        node.close()
