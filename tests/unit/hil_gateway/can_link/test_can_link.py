"""Links that need no SocketCAN: UDP multicast on loopback, python-can's virtual bus, the deterministic wire."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator

import pytest

from hil_gateway.can_link import EXTENDED_ID, BusState, CanLink, Frame, VirtualWire, open_link
from hil_gateway.can_link.socketcan import state_after_error
from hil_gateway.can_link.udp import UdpLink
from hil_gateway.can_link.wire import QUEUE_FRAMES
from hil_gateway.config import CanConfig
from hil_gateway.process.clock import VirtualClock
from hil_gateway.process.errors import InputError


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture(params=["udp_multicast", "virtual"])
def config(request: pytest.FixtureRequest) -> CanConfig:
    port = free_port()
    return CanConfig(interface=request.param, channel=f"test-{port}", multicast_port=port)


@pytest.fixture
def links(config: CanConfig) -> Iterator[list[CanLink]]:
    links = [open_link(config) for _ in range(3)]
    yield links
    for link in links:
        link.close()


def collect(link: CanLink, count: int) -> list[Frame]:
    frames: list[Frame] = []
    end = time.monotonic() + 5
    while len(frames) < count and time.monotonic() < end:
        frames += link.receive(0.1)
    return frames


def test_every_link_hears_the_others_and_not_itself(links: list[CanLink]) -> None:
    for index, link in enumerate(links):
        assert link.send(0x100 + index, bytes([index]))
    for index, link in enumerate(links):
        heard = {(frame.id, frame.data) for frame in collect(link, 2) + link.receive()}
        assert heard == {(0x100 + other, bytes([other])) for other in range(3) if other != index}


def test_frames_keep_their_order_and_are_stamped_on_the_monotonic_clock(links: list[CanLink]) -> None:
    before = time.monotonic_ns()
    for number in range(200):
        assert links[0].send(0x514, number.to_bytes(8, "little"))
    frames = collect(links[1], 200)
    after = time.monotonic_ns()
    assert [int.from_bytes(frame.data, "little") for frame in frames] == list(range(200))
    stamps = [frame.stamp_ns for frame in frames]
    assert before - 2_000_000 <= stamps[0] and stamps[-1] <= after
    assert stamps == sorted(stamps)
    assert links[1].stats().received == 200
    assert links[0].stats().sent == 200


def test_a_29_bit_identifier_arrives_as_one(links: list[CanLink]) -> None:
    for frame_id in (0x18FF1001 | EXTENDED_ID, 0x001 | EXTENDED_ID, 0x001):
        assert links[0].send(frame_id, b"ab")
    assert [f.id for f in collect(links[1], 3)] == [0x18FF1001 | EXTENDED_ID, 0x001 | EXTENDED_ID, 0x001]
    assert links[1].stats().malformed == 0


def test_receive_waits_no_longer_than_told(links: list[CanLink]) -> None:
    started = time.monotonic()
    assert links[0].receive(0.05) == []
    assert 0.04 < time.monotonic() - started < 0.5
    started = time.monotonic()
    assert links[0].receive() == []
    assert time.monotonic() - started < 0.04


@pytest.fixture
def udp() -> Iterator[UdpLink]:
    link = UdpLink("239.74.163.2", free_port())
    yield link
    link.close()


def datagram(link: UdpLink, payload: bytes, interface: str = "127.0.0.1") -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(interface))
        sender.sendto(payload, (link._group, link._port))


@pytest.mark.promise("F1")
@pytest.mark.parametrize(
    "payload", [b"", b"junk", b"\x81\xa1x\x01", b"\x81\xa2id\x01", b"\xff" * 500, b"\x80", b"\x93\x01\x02\x03"]
)
def test_foreign_datagrams_are_counted_not_raised(udp: UdpLink, payload: bytes) -> None:
    datagram(udp, payload)
    assert udp.receive(0.2) == []
    assert udp.stats().malformed == 1


def test_python_can_datagrams_are_understood(udp: UdpLink) -> None:
    can = pytest.importorskip("can")
    from can.interfaces.udp_multicast.utils import pack_message

    datagram(udp, pack_message(can.Message(arbitration_id=0x514, data=b"12345678", is_extended_id=False)))
    datagram(udp, pack_message(can.Message(arbitration_id=0x514, data=b"1", is_extended_id=True)))
    datagram(udp, pack_message(can.Message(arbitration_id=0x514, is_remote_frame=True, is_extended_id=False)))
    datagram(udp, pack_message(can.Message(arbitration_id=0x4, data=bytes(8), is_error_frame=True)))
    frames = collect(udp, 3)
    assert [(f.id, f.data, f.is_error) for f in frames[:2]] == [
        (0x514, b"12345678", False),
        (0x514 | EXTENDED_ID, b"1", False),
    ]
    assert frames[2].is_error
    assert (udp.stats().malformed, udp.stats().error_frames, udp.stats().lost) == (1, 1, 0)


def test_python_can_understands_our_datagrams(udp: UdpLink) -> None:
    from can.interfaces.udp_multicast.utils import unpack_message

    message = unpack_message(udp._pack(0x514, b"12345678"), replace={"timestamp": 1.0}, check=True)
    assert (message.arbitration_id, bytes(message.data), message.is_extended_id) == (0x514, b"12345678", False)
    assert not (message.is_error_frame or message.is_remote_frame or message.is_fd)


def test_a_gap_in_a_senders_numbers_is_counted_as_lost(udp: UdpLink) -> None:
    other = UdpLink(udp._group, udp._port)
    other.send(1, b"")
    for _ in range(7):
        other._pack(2, b"")  # numbered, never sent
    other.send(3, b"")
    other.close()
    assert [frame.id for frame in collect(udp, 2)] == [1, 3]
    assert udp.stats().lost == 7


def test_an_overflowing_receive_queue_is_counted_exactly(udp: UdpLink) -> None:
    udp._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)  # type: ignore[union-attr]
    other = UdpLink(udp._group, udp._port)
    for _ in range(2000):
        other.send(1, bytes(8))
    received = len(udp.receive(0.2))
    other.send(2, b"")  # the loss shows with the next frame
    received += len(collect(udp, 1))
    other.close()
    assert received < 2001
    assert udp.stats().lost == 2001 - received


@pytest.mark.parametrize(
    ("config", "complaint"),
    [
        (CanConfig(interface="udp_multicast", multicast_group="10.1.1.1"), "239.0.0.0/8"),
        (CanConfig(interface="udp_multicast", multicast_group="no.such.group.invalid"), "239.0.0.0/8"),
        (CanConfig(interface="socketcan", channel="vcan77"), "vcan77: .*(vcan77 type vcan|deploy/with-vcan)"),
    ],
)
def test_a_bus_that_cannot_be_opened_is_one_line_with_the_remedy(config: CanConfig, complaint: str) -> None:
    with pytest.raises(InputError, match=complaint) as caught:
        open_link(config)
    assert "\n" not in str(caught.value)


def test_a_busy_port_is_one_line_with_the_remedy() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("", 0))
        config = CanConfig(interface="udp_multicast", multicast_port=other.getsockname()[1])
        with pytest.raises(InputError, match=r"in use by another program; set can\.multicast_port"):
            open_link(config)


def test_auto_falls_back_to_loopback_where_the_channel_does_not_exist() -> None:
    link = open_link(CanConfig(interface="auto", channel="nocan9", multicast_port=free_port()))
    assert link.kind == "udp_multicast"
    link.close()


def test_the_wire_is_deterministic_and_bounded() -> None:
    clock = VirtualClock(5)
    wire = VirtualWire(clock)
    a, b, recorder = wire.link(), wire.link(), wire.link()
    assert a.send(1, b"x")
    clock.advance(7)
    assert b.send(2, b"y")
    assert a.receive() == [Frame(2, b"y", 12)]
    assert b.receive() == [Frame(1, b"x", 5)]
    assert recorder.receive() == [Frame(1, b"x", 5), Frame(2, b"y", 12)]
    for _ in range(QUEUE_FRAMES + 3):
        a.send(3, b"")
    assert (len(b.receive()), b.stats().lost) == (QUEUE_FRAMES, 3)
    recorder.close()
    recorder.close()
    a.send(4, b"")
    assert recorder.stats().lost == 3  # unplugged: nothing more arrives


def test_a_pulled_plug_fails_sends_and_shows_in_the_bus_state() -> None:
    wire = VirtualWire(VirtualClock())
    a, b = wire.link(), wire.link()
    wire.up = False
    assert not a.send(1, b"")
    assert b.receive() == []
    assert (a.stats().bus_state, a.stats().send_failures) == (BusState.DOWN, 1)
    wire.up = True
    assert a.send(1, b"")
    assert a.stats().bus_state is BusState.ERROR_ACTIVE


@pytest.mark.parametrize(
    ("error_class", "controller", "state"),
    [
        (0x40, 0, BusState.BUS_OFF),
        (0x100, 0, BusState.ERROR_ACTIVE),
        (0x04, 0x04, BusState.ERROR_WARNING),
        (0x04, 0x20, BusState.ERROR_PASSIVE),
        (0x04, 0x40, BusState.ERROR_ACTIVE),
        (0x04, 0x01, None),
        (0x80, 0, None),
    ],
)
def test_error_frames_tell_the_bus_state(error_class: int, controller: int, state: BusState | None) -> None:
    assert state_after_error(error_class, bytes([0, controller, 0, 0, 0, 0, 0, 0])) == state
