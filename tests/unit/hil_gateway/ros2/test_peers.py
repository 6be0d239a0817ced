"""The bridge's node among real Zenoh sessions: a peer written by hand, another implementation, routers that die."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from support.cars import car_messages
from support.cars.ros_peer import Peer, decode, echoes
from zenoh_ros2_sdk.publisher import ROS2Publisher
from zenoh_ros2_sdk.session import ZenohSession
from zenoh_ros2_sdk.subscriber import ROS2Subscriber

from hil_gateway.can_link.cdr import pack_frame
from hil_gateway.process.errors import InputError
from hil_gateway.ros2 import topics as ros
from hil_gateway.ros2.outgoing import Outgoing
from hil_gateway.ros2.session import ZenohRosNode
from hil_gateway.ros2.topics import RosTopic
from hil_gateway.ros2.types import Types
from hil_gateway.settings.ros2 import Ros2Config

TYPES = Types("av24")
ODOMETRY = "nav_msgs::msg::dds_::Odometry_", "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0"
GEAR = "std_msgs::msg::dds_::UInt8_", "RIHS01_6138bd83d8c3569cb80a667db03cfc1629f529fee79d944c39c34e352e72f010"
AXLES = "tf2_msgs::msg::dds_::TFMessage_", "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"
GEAR_CMD = RosTopic("/team/gear", "std_msgs/msg/UInt8")
STEERING = (
    "raptor_dbw_msgs::msg::dds_::SteeringCmd_",
    "RIHS01_72266606c0bbda469d7504a11cbb10970055335f7d09ee364dc04ccd1b178ce5",
)


@pytest.fixture
def port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture
def router(port) -> Iterator[Peer]:
    """What `rmw_zenohd` is: a Zenoh router on the port."""
    with Peer(port, "router", mode="router") as peer:
        yield peer


def opened(port: int, mode: str = "peer") -> ZenohRosNode:
    return ZenohRosNode(Ros2Config.model_validate({"mode": mode, "connect": [f"tcp/127.0.0.1:{port}"]}), TYPES)


@pytest.fixture
def bridge(port, router) -> Iterator[ZenohRosNode]:
    node = opened(port)
    try:
        node.join()
        yield node
    finally:
        node.close()


def until(found: Callable[[], Any], seconds: float = 5.0) -> Any:
    """What `found` gives once it gives something."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        if value := found():
            return value
        time.sleep(0.02)
    raise AssertionError("did not happen")


def send_odometry(node: ZenohRosNode) -> None:
    message = Outgoing(TYPES).odometry(car_messages.estimate(0, x=10.0, vx=30.0), 5 * 10**9)
    node.publish(ros.ODOMETRY, TYPES.to_bytes(ros.ODOMETRY.type, message), time.time_ns())


def heard(subscriber: Any, send: Callable[[], None]) -> list[Any]:
    """What arrives once something does, sent again and again."""

    def attempt() -> list[Any]:
        send()
        time.sleep(0.05)
        return list(echoes(subscriber))

    return list(until(attempt))


def test_peer_lists_and_echoes_what_the_bridge_publishes(bridge, port):
    bridge.advertise(ros.ODOMETRY)
    bridge.subscribe(ros.STEERING_CMD)
    with Peer(port, "viewer") as peer:
        until(lambda: ros.ODOMETRY.name in peer.topics())
        assert peer.topics()[ros.ODOMETRY.name] == (*ODOMETRY, "::,10:,:,:,,")
        until(lambda: peer.topics("MS").get(ros.STEERING_CMD.name, ())[:2] == STEERING)
        until(lambda: any(token.endswith("/NN/%/%/av24_bridge") for token in peer.graph()))
        subscriber = peer.subscribe(ros.ODOMETRY.name, *ODOMETRY)
        until(lambda: bridge.wanted(ros.ODOMETRY))
        before = time.time_ns()
        for _ in range(3):
            send_odometry(bridge)
        got: list[Any] = []
        until(lambda: got.extend(echoes(subscriber)) or len(got) == 3)
    first, second, third = got
    assert (first.sequence, second.sequence, third.sequence) == (1, 2, 3)
    assert before <= first.source_ns <= first.received_ns
    assert first.gid == third.gid != bytes(16)
    assert (first.fields["x"], first.fields["vx"], first.fields["time.sec"]) == (10.0, 30.0, 5)


def test_bridge_takes_what_a_peer_publishes_with_its_sequence_and_time(bridge, port):
    bridge.subscribe(GEAR_CMD)
    with Peer(port, "driver") as peer:
        peer.publish(GEAR_CMD.name, *GEAR, b"\0\1\0\0\3", source_ns=123)  # declares
        until(lambda: any("/MP/%/%/driver/" in token for token, _ in bridge.graph_changes()))
        got = until(lambda: peer.publish(GEAR_CMD.name, *GEAR, b"\0\1\0\0\4", source_ns=456) or bridge.received())
    newest = got[-1]
    assert newest.topic == GEAR_CMD
    assert (newest.data[-1], newest.attachment.source_ns) in ((3, 123), (4, 456))
    assert newest.attachment.sequence >= 1


def test_late_subscriber_gets_the_axles(bridge, port):
    from zenoh import ext
    from zenoh.handlers import RingChannel

    bridge.advertise(ros.TF_STATIC)
    data = TYPES.to_bytes(ros.TF_STATIC.type, Outgoing(TYPES).axles(1.5, 1.5, 7))
    bridge.publish(ros.TF_STATIC, data, time.time_ns())
    with Peer(port, "late") as peer:
        subscriber = ext.declare_advanced_subscriber(
            peer.session,
            f"0/tf_static/{AXLES[0]}/{AXLES[1]}",
            RingChannel(10),
            history=ext.HistoryConfig(detect_late_publishers=True),
        )
        sample = until(subscriber.try_recv)
        assert sample.payload.to_bytes() == data
        assert len(sample.attachment.to_bytes()) == 33


def test_bridge_is_the_router_itself(port):
    node = opened(port, "router")
    try:
        node.join()
        node.advertise(ros.ODOMETRY)
        with Peer(port, "viewer") as viewer, Peer(port, "other") as other:
            subscriber = viewer.subscribe(ros.ODOMETRY.name, *ODOMETRY)
            assert heard(subscriber, lambda: send_odometry(node))
            gears = viewer.subscribe("/gear", *GEAR)  # and it passes on what nodes say to each other
            assert heard(gears, lambda: other.publish("/gear", *GEAR, b"\0\1\0\0\1"))
    finally:
        node.close()


def test_second_bridge_and_second_router_are_refused(bridge, port):
    second = opened(port)
    try:
        with pytest.raises(InputError, match=f"has a bridge already .session {bridge.session}."):
            second.join()
    finally:
        second.close()
    with pytest.raises(InputError, match=r"port is busy .*rmw_zenohd"):
        opened(port, "router")


def test_client_without_router_says_what_to_start(port):
    with pytest.raises(InputError, match=rf"no router at tcp/127.0.0.1:{port} \(ros2.connect\): start"):
        opened(port, "client")


def test_linked_peers_go_on_when_the_router_dies_and_a_newcomer_meets_them_when_it_is_back(bridge, router, port):
    bridge.advertise(ros.ODOMETRY)
    with Peer(port, "viewer") as viewer:
        subscriber = viewer.subscribe(ros.ODOMETRY.name, *ODOMETRY)
        assert heard(subscriber, lambda: send_odometry(bridge))
        router.close()
        time.sleep(0.5)
        list(echoes(subscriber))
        assert heard(subscriber, lambda: send_odometry(bridge))
        with Peer(port, "router again", mode="router"), Peer(port, "newcomer") as newcomer:
            later = newcomer.subscribe(ros.ODOMETRY.name, *ODOMETRY)
            assert heard(later, lambda: send_odometry(bridge))
            assert ros.ODOMETRY.name in newcomer.topics()


FRAME = "std_msgs/Header header\nuint32 id\nbool is_rtr\nbool is_extended\nbool is_error\nuint8 dlc\nuint8[8] data"


@pytest.fixture
def sdk(router, port) -> Iterator[dict[str, Any]]:
    """Another implementation of the format, given its definitions: it would fetch them."""
    session = ZenohSession.get_instance("127.0.0.1", port)
    session.register_message_type("int32 sec\nuint32 nanosec", "builtin_interfaces/msg/Time")
    session.register_message_type("builtin_interfaces/Time stamp\nstring frame_id", "std_msgs/msg/Header")
    yield {"router_ip": "127.0.0.1", "router_port": port}
    session.close()


def test_another_implementation_subscribes_and_publishes(bridge, sdk):
    from hil_gateway.can_link import Frame

    bridge.advertise(ros.FRAMES)
    bridge.subscribe(GEAR_CMD)
    of = TYPES.of(ros.FRAMES.type)
    got: list[Any] = []
    subscriber = ROS2Subscriber(
        ros.FRAMES.name, "can_msgs/msg/Frame", got.append, msg_definition=FRAME, type_hash=of.hash, **sdk
    )
    publisher = ROS2Publisher(
        GEAR_CMD.name, "std_msgs/msg/UInt8", msg_definition="uint8 data", type_hash=GEAR[1], **sdk
    )
    try:
        data = pack_frame(Frame(0x514, b"\1\2\3", 0), 9 * 10**9, "can")
        until(lambda: bridge.publish(ros.FRAMES, data, time.time_ns()) or time.sleep(0.05) or got)
        assert (got[0].id, got[0].dlc, list(got[0].data)[:3], got[0].header.stamp.sec) == (0x514, 3, [1, 2, 3], 9)
        assert decode(of.dds, data)["data"] == (1, 2, 3, 0, 0, 0, 0, 0)
        received = until(lambda: publisher.publish(data=3) or time.sleep(0.05) or bridge.received())
        assert received[-1].data[4] == 3
        assert received[-1].attachment is not None
    finally:
        subscriber.close()
        publisher.close()
