"""SocketCAN link and codec against can-utils and cantools on a real interface."""

from __future__ import annotations

import random
import re
import socket
import struct
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import cantools
import pytest

from can_dbc.codec import Fault, load_codec
from can_dbc.folder import SHIPPED
from hil_gateway.can_link import EXTENDED_ID, BusState, Frame, open_link
from hil_gateway.can_link.socketcan import SocketCanLink
from hil_gateway.config import CanConfig

pytestmark = pytest.mark.vcan
CODEC = load_codec()
PEER = cantools.database.load_file(SHIPPED / "av24/av24.dbc")
Opener = Callable[[], SocketCanLink]


def ip(*arguments: str) -> None:
    subprocess.run(["ip", *arguments], check=True, capture_output=True)


def collect(link: SocketCanLink, count: int, seconds: float = 5.0) -> list[Frame]:
    frames: list[Frame] = []
    end = time.monotonic() + seconds
    while len(frames) < count and time.monotonic() < end:
        frames += link.receive(0.05)
    return frames


def cansend(channel: str, *frames: str) -> None:
    """One shell for many `cansend`: starting programs is slow in user-mode Linux."""
    subprocess.run(["sh", "-ec", "\n".join(f"cansend {channel} {frame}" for frame in frames)], check=True)


def random_legal(name: str, seed: int) -> dict[str, float]:
    """Values of a message within what its DBC declares, on its grid, DBC units."""
    rng, values = random.Random(f"{name}{seed}"), {}
    for signal in CODEC.messages[name].signals:
        low, high = signal.declared or (-1e30, 1e30)
        ends = sorted((end - signal.offset) / signal.scale for end in (low, high))
        raw = rng.randint(max(signal.raw_range[0], int(ends[0])), min(signal.raw_range[1], int(ends[1])))
        values[signal.name] = raw * signal.scale + signal.offset
    return values


@contextmanager
def candump(channel: str, count: int) -> Iterator[Callable[[], list[str]]]:
    """Yields a function that waits for `count` lines of candump, which must be running by then."""
    command = ["candump", "-L", "-n", str(count), channel]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        time.sleep(0.3)  # it prints nothing when its socket is bound
        yield lambda: process.communicate(timeout=20)[0].splitlines()  # noqa: PLW0108 (nothing is run yet)
        process.kill()


@pytest.mark.promise("F2")
def test_every_message_sent_by_cansend_from_cantools_bytes_is_decoded_alike(
    channel: str, open_socketcan: Opener
) -> None:
    link = open_socketcan()
    expected = {name: random_legal(name, 1) for name in CODEC.messages}
    cansend(
        channel,
        *(f"{PEER.get_message_by_name(n).frame_id:03X}#{PEER.encode_message(n, v).hex()}" for n, v in expected.items()),
    )
    frames = collect(link, len(expected))
    assert len(frames) == len(expected) == 56
    for frame, (name, values) in zip(frames, expected.items(), strict=True):
        assert CODEC.decode_raw(frame.id, frame.data) == pytest.approx(values, rel=1e-9), name


@pytest.mark.promise("F2")
def test_every_message_we_send_is_read_by_candump_and_cantools(channel: str, open_socketcan: Opener) -> None:
    link = open_socketcan()
    expected = {name: random_legal(name, 2) for name in CODEC.messages}
    with candump(channel, len(expected)) as lines:
        for name, values in expected.items():
            assert link.send(*CODEC.encode_raw(name, values))
        dumped = lines()
    for line, (name, values) in zip(dumped, expected.items(), strict=True):
        match = re.fullmatch(rf"\(\d+\.\d+\) {channel} ([0-9A-F]+)#([0-9A-F]*)(?: [RT])?", line)
        assert match, line
        decoded = PEER.decode_message(int(match[1], 16), bytes.fromhex(match[2]), decode_choices=False)
        assert decoded == pytest.approx(values, rel=1e-9), name


@pytest.mark.promise("F1")
def test_random_traffic_of_cangen_gives_values_or_faults_and_none_is_lost(channel: str, open_socketcan: Opener) -> None:
    """A burst of 5,000 frames; the default receive buffer would keep some 300 to 900 of them."""
    link = open_socketcan()
    subprocess.run(["cangen", channel, "-g", "0", "-n", "5000", "-I", "r", "-L", "r", "-D", "r", "-i"], check=True)
    frames = collect(link, 5000)
    assert (len(frames), link.stats().lost) == (5000, 0)
    decoded = [CODEC.decode(frame.id, frame.data) for frame in frames]
    assert 0 < sum(isinstance(values, Fault) for values in decoded) <= 5000


def test_own_frames_are_not_heard_but_a_second_link_of_the_same_process_hears_them(open_socketcan: Opener) -> None:
    link, recorder = open_socketcan(), open_socketcan()
    assert link.send(0x514, b"12345678")
    assert [frame.data for frame in collect(recorder, 1)] == [b"12345678"]
    assert link.receive(0.05) == []


def test_other_kinds_of_frames_cannot_pass_for_data(channel: str, open_socketcan: Opener) -> None:
    link = open_socketcan()
    cansend(channel, "514#R", "00000514#0102", "514#0102", "514##10102030405060708090A0B0C")
    frames = collect(link, 2)
    assert [(frame.id, frame.data) for frame in frames] == [(0x514 | EXTENDED_ID, b"\1\2"), (0x514, b"\1\2")]
    assert link.receive(0.05) == []
    assert link.stats().malformed == 1  # the remote request; FD frames never reach a classic socket


def test_stamps_are_on_the_monotonic_clock_and_survive_a_step_of_the_wall_clock(
    channel: str, open_socketcan: Opener
) -> None:
    link = open_socketcan()
    before = time.monotonic_ns()
    link.receive()  # a stamp is never older than the last look into the queue
    cansend(channel, "514#0102030405060708")
    wall = time.time()
    try:
        time.clock_settime(time.CLOCK_REALTIME, wall + 3600)
    except PermissionError:
        pytest.skip("may not set the clock here")
    try:
        (frame,) = collect(link, 1)
        assert before - 1_000_000 <= frame.stamp_ns <= time.monotonic_ns()
        time.clock_settime(time.CLOCK_REALTIME, wall)
        started = time.monotonic_ns()
        link.receive()
        cansend(channel, "514#0102030405060708")
        (frame,) = collect(link, 1)
        assert started - 1_000_000 <= frame.stamp_ns <= time.monotonic_ns()
    finally:
        time.clock_settime(time.CLOCK_REALTIME, wall)


def seconds_until(link: SocketCanLink, state: BusState) -> float:
    started = time.monotonic()
    while link.stats().bus_state is not state and time.monotonic() < started + 5:
        link.receive(0.01)
    return time.monotonic() - started


@pytest.mark.promise("L7")
def test_interface_down_and_up_is_recovered_within_a_second(channel: str, open_socketcan: Opener) -> None:
    link, other = open_socketcan(), open_socketcan()
    ip("link", "set", channel, "down")
    assert seconds_until(link, BusState.DOWN) < 0.5
    assert not link.send(0x578, bytes(8))
    assert link.stats().send_failures == 1
    ip("link", "set", channel, "up")
    assert seconds_until(link, BusState.ERROR_ACTIVE) < 1.0
    assert seconds_until(other, BusState.ERROR_ACTIVE) < 1.0
    assert link.send(0x578, bytes(8))
    assert [frame.id for frame in collect(other, 1)] == [0x578]


@pytest.mark.promise("L7")
def test_interface_deleted_and_created_again_is_recovered_within_a_second(channel: str, open_socketcan: Opener) -> None:
    link = open_socketcan()
    ip("link", "del", channel)
    assert seconds_until(link, BusState.DOWN) < 0.5
    assert not link.send(0x578, bytes(8))
    ip("link", "add", channel, "type", "vcan")
    ip("link", "set", channel, "up")
    assert seconds_until(link, BusState.ERROR_ACTIVE) < 1.0
    other = open_socketcan()
    assert link.send(0x578, bytes(8))
    assert [frame.id for frame in collect(other, 1)] == [0x578]
    assert link.stats().reopened == 1


def test_a_link_opened_on_an_interface_that_is_down_says_so_and_comes_up_with_it(
    channel: str, open_socketcan: Opener
) -> None:
    ip("link", "set", channel, "down")
    link = open_socketcan()
    assert link.stats().bus_state is BusState.DOWN
    ip("link", "set", channel, "up")
    assert seconds_until(link, BusState.ERROR_ACTIVE) < 1.0


@pytest.mark.promise("L7")
def test_error_frames_are_told_apart_and_set_the_bus_state(channel: str, open_socketcan: Opener) -> None:
    link = open_socketcan()
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as injector:
        injector.bind((channel,))
        for error_class, controller, state in (
            (0x04, 0x08, BusState.ERROR_WARNING),
            (0x04, 0x20, BusState.ERROR_PASSIVE),
            (0x40, 0x00, BusState.BUS_OFF),
            (0x100, 0x00, BusState.ERROR_ACTIVE),
        ):
            data = bytes([0, controller, 0, 0, 0, 0, 96, 96])
            injector.send(struct.pack("=IB3x8s", 0x2000_0000 | error_class, 8, data))
            (frame,) = collect(link, 1)
            assert (frame.is_error, frame.id, frame.data) == (True, error_class, data)
            assert link.stats().bus_state is state
    assert link.stats().error_frames == 4


def test_receive_overflow_is_counted_frame_by_frame(channel: str, open_socketcan: Opener) -> None:
    link = open_socketcan()
    assert link._socket is not None
    link._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 20_000)
    subprocess.run(["cangen", channel, "-g", "0", "-n", "2000", "-I", "514", "-L", "8", "-i"], check=True)
    received = len(link.receive(0.2))
    cansend(channel, "514#0102030405060708")  # the kernel tells of the loss with the next frame
    received += len(collect(link, 1))
    assert received < 2001
    assert link.stats().lost == 2001 - received


def test_auto_takes_socketcan_where_the_channel_exists(channel: str) -> None:
    link = open_link(CanConfig(channel=channel))
    assert link.kind == "socketcan"
    link.close()


@pytest.fixture
def faulty_cable(channel: str) -> Iterator[tuple[str, str, str]]:
    """(namespace of the car, its interface, our interface): vxcan from the car, can-gw in between, vxcan to us.

    A frame may cross as many can-gw hops as the module was loaded with (one by default): one is used.
    """
    car, inner, outer, ours = "hilcar", "vxinner", "vxouter", "vxours"
    ip("netns", "add", car)
    try:
        ip("link", "add", inner, "type", "vxcan", "peer", "name", "can0", "netns", car)
        ip("link", "add", outer, "type", "vxcan", "peer", "name", ours)
        for name in (inner, outer, ours):
            ip("link", "set", name, "up")
        ip("-n", car, "link", "set", "can0", "up")
        yield car, inner, outer
    finally:
        subprocess.run(["cangw", "-F"], check=False, capture_output=True)
        ip("netns", "del", car)
        subprocess.run(["ip", "link", "del", outer], check=False, capture_output=True)


def test_frames_dropped_and_altered_between_namespaces_are_seen_as_such(faulty_cable: tuple[str, str, str]) -> None:
    """The car's brake report (0x515) never arrives; the counter of its accelerator report (0x516) is frozen."""
    car, inner, outer = faulty_cable
    route = ["cangw", "-A", "-s", inner, "-d", outer, "-e"]
    subprocess.run([*route, "-f", "516:7FF", "-m", "AND:D:516.3.FFFF000000000000"], check=True, capture_output=True)
    subprocess.run([*route, "-f", "514:7FF"], check=True, capture_output=True)
    link = SocketCanLink("vxours")
    frames = [f"{frame_id:03X}#{data.hex()}" for n in range(3) for frame_id, data in reports(n)]
    script = "\n".join(f"cansend can0 {frame}" for frame in frames)
    subprocess.run(["ip", "netns", "exec", car, "sh", "-ec", script], check=True)
    heard = collect(link, 6)
    link.close()
    assert [frame.id for frame in heard] == [0x514, 0x516] * 3
    accelerator = [CODEC.decode_raw(frame.id, frame.data) for frame in heard if frame.id == 0x516]
    assert all(
        not isinstance(values, Fault) and values["acc_pedal_fdbk"] == pytest.approx(12.3) for values in accelerator
    )
    assert [values["acc_pedal_fdbk_counter"] for values in accelerator if not isinstance(values, Fault)] == [0, 0, 0]


def reports(counter: int) -> list[tuple[int, bytes]]:
    """Wheel speed, brake and accelerator report of one period."""
    speeds = {f"wheel_speed_{corner}": 100.0 for corner in ("FL", "FR", "RL", "RR")}
    brake = {"brake_pressure_fdbk_front": 0, "brake_pressure_fdbk_rear": 0, "brk_pressure_fdbk_counter": counter}
    accelerator = {"acc_pedal_fdbk": 12.3, "acc_pedal_fdbk_counter": counter + 1}
    return [
        CODEC.encode_raw("wheel_speed_report", speeds),
        CODEC.encode_raw("brake_pressure_report", brake),
        CODEC.encode_raw("accelerator_report", accelerator),
    ]
