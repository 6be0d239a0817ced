"""The bus between processes: bounded, late joiners, invalid messages, busy ports."""

from __future__ import annotations

import json
import subprocess
import sys
import time
import tracemalloc

import pytest

from hil_gateway.bus import topics
from hil_gateway.bus.messages import Command, OperatorAction, OperatorCommand
from hil_gateway.bus.zenoh_bus import ZenohBus, open_bus, session_config
from hil_gateway.config import ZenohConfig
from hil_gateway.process.errors import InputError


@pytest.fixture
def port() -> int:
    import socket

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture
def config(port) -> ZenohConfig:
    return ZenohConfig(connect=(f"tcp/127.0.0.1:{port}",))


def message(seq: int) -> OperatorCommand:
    return OperatorCommand(stamp_ns=seq, seq=seq, source="test", action=OperatorAction.STOP)


def exchange(sender: ZenohBus, subscription, seconds: float = 5.0) -> list[OperatorCommand]:
    """Publish until something arrives."""
    deadline, seq = time.monotonic() + seconds, 0
    while time.monotonic() < deadline:
        sender.publish(topics.OPERATOR, message(seq))
        seq += 1
        time.sleep(0.02)
        if got := subscription.poll(0):
            return got
    raise AssertionError("nothing arrived")


def test_processes_meet_whoever_starts_first_and_also_after_the_hub_restarted(config):
    planner, estimator = open_bus(config, "planner"), open_bus(config, "estimator")
    heard = estimator.subscribe(topics.OPERATOR)
    hub = open_bus(config, "gateway")
    try:
        exchange(planner, heard)
        hub.close()
        hub = open_bus(config, "gateway")
        exchange(planner, hub.subscribe(topics.OPERATOR))
    finally:
        for bus in (planner, estimator, hub):
            bus.close()


def test_one_runtime_of_zenoh_serves_all_links_of_a_process(port):
    code = f"""
import pathlib, time
from hil_gateway.bus.zenoh_bus import open_bus
from hil_gateway.config import ZenohConfig
buses = [open_bus(ZenohConfig(connect=("tcp/127.0.0.1:{port}",)), name) for name in ("gateway", "planner", "estimator")]
time.sleep(0.5)
print(*(path.read_text().strip() for path in pathlib.Path("/proc/self/task").glob("*/comm")))
for bus in buses:
    bus.close()
"""
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=30)
    runtimes = {name.partition("-")[0] for name in ran.stdout.split()}
    assert runtimes & {"rx", "tx", "acc"} == {"rx"}, ran.stdout


def test_a_message_of_megabytes_never_reaches_a_reader(config):
    """Valid JSON, a thousand times as long as any of ours: reading it would hold the gateway up."""
    hub, rogue, other = open_bus(config, "gateway"), open_bus(config, "rogue"), open_bus(config, "planner")
    try:
        heard = hub.subscribe(topics.OPERATOR, depth=100)
        exchange(rogue, heard)
        time.sleep(0.2)
        heard.poll(0)
        rogue._session.put(topics.OPERATOR.key, message(7).model_dump_json().encode() + b" " * 5_000_000)
        time.sleep(1.0)
        assert heard.poll(0) == []
        exchange(other, heard)
    finally:
        for bus in (rogue, other, hub):
            bus.close()


def test_a_slow_reader_keeps_the_newest_and_counts_the_rest(config):
    hub, other = open_bus(config, "gateway"), open_bus(config, "planner")
    try:
        asked, heard = hub.subscribe(topics.OPERATOR, depth=100), hub.subscribe(topics.COMMAND, depth=3)
        exchange(other, asked)
        time.sleep(0.2)
        other.publish(topics.OPERATOR, message(5_000_000))  # a person's next request: nothing is lost between them
        _all_of(asked, 1)
        assert asked.dropped == 0
        other.publish(topics.COMMAND, command(999))
        _all_of(heard, 1)
        before = heard.dropped
        for seq in range(1000, 1010):
            other.publish(topics.COMMAND, command(seq))
        time.sleep(0.5)
        assert [got.seq for got in heard.poll(0)] == [1007, 1008, 1009]
        assert heard.dropped - before >= 7
    finally:
        hub.close()
        other.close()


def test_two_processes_that_send_the_same_are_said_and_one_that_starts_over_is_not(config, caplog):
    hub, one, two = open_bus(config, "gateway"), open_bus(config, "planner"), open_bus(config, "planner")
    try:
        heard = hub.subscribe(topics.OPERATOR, depth=1000)
        exchange(two, heard)
        exchange(one, heard)
        for seq in (*range(100, 150), *range(100)):
            one.publish(topics.OPERATOR, message(seq))
            _all_of(heard, 1)
        for _ in range(5):  # a request is sent again until it is answered
            one.publish(topics.OPERATOR, message(200))
            _all_of(heard, 1)
        assert not caplog.messages
        for seq in range(100, 120):
            one.publish(topics.OPERATOR, message(seq))
            two.publish(topics.OPERATOR, message(seq - 90))
            _all_of(heard, 2)
        assert "do two processes send it?" in caplog.messages[0]
        assert len(caplog.messages) < 10
    finally:
        for bus in (one, two, hub):
            bus.close()


def command(seq: int) -> Command:
    return Command(stamp_ns=1, seq=seq, source="planner", state_stamp_ns=1, steer=0.0, drive=0.0)


def _all_of(subscription, count: int) -> None:
    deadline = time.monotonic() + 10.0
    while (count := count - len(subscription.poll(0))) > 0:
        assert time.monotonic() < deadline
        time.sleep(0.001)


def test_a_new_sender_name_in_every_message_takes_no_memory(config):
    hub, other = open_bus(config, "gateway"), open_bus(config, "planner")
    try:
        heard = hub.subscribe(topics.OPERATOR, depth=256)
        exchange(other, heard)
        tracemalloc.start()
        taken = number = 0
        while taken <= 1000 and number < 20_000:  # a busy computer drops some
            other.publish(topics.OPERATOR, message(0).model_copy(update={"source": f"{number:064d}"}))
            number += 1
            taken += len(heard.poll(0)) if number % 50 == 0 else 0
        time.sleep(0.2)  # what is still under way is no name that is kept
        heard.poll(0)
        bus_only = tracemalloc.Filter(True, "*/zenoh_bus.py")
        kept = sum(block.size for block in tracemalloc.take_snapshot().filter_traces([bus_only]).traces)
    finally:
        tracemalloc.stop()
        hub.close()
        other.close()
    assert taken > 1000
    assert kept < 40_000, "1,000 names take 180 kB, the 64 that are kept 11 to 16 kB"


@pytest.mark.parametrize(
    "payload",
    [
        b"", b"\xff\x00", b"{", b"null", b"[]", b'{"stamp_ns": NaN}',
        json.dumps({**message(1).model_dump(), "extra": 1}).encode(),
        json.dumps({**message(1).model_dump(), "seq": -1}).encode(),
    ],
)  # fmt: skip
def test_what_is_no_message_is_counted_and_never_raised(config, payload):
    hub, other = open_bus(config, "gateway"), open_bus(config, "planner")
    try:
        heard = hub.subscribe(topics.OPERATOR, depth=8)
        exchange(other, heard)
        raw = other._session.declare_publisher(topics.OPERATOR.key)
        raw.put(payload)
        deadline = time.monotonic() + 3
        while heard.invalid == 0 and time.monotonic() < deadline:
            assert heard.poll(0) == []
            time.sleep(0.02)
        assert heard.invalid == 1
        assert exchange(other, heard)
    finally:
        hub.close()
        other.close()


def test_publishing_without_any_reader_does_not_block(config):
    bus = open_bus(config, "planner")
    try:
        started = time.monotonic()
        for seq in range(2000):
            bus.publish(topics.OPERATOR, message(seq))
        assert time.monotonic() - started < 2.0
    finally:
        bus.close()


def test_a_busy_port_is_one_clear_line(config, port):
    hub = open_bus(config, "gateway")
    try:
        with pytest.raises(InputError, match=rf"127.0.0.1:{port}: the port is busy .*another endpoint"):
            open_bus(config, "gateway")
    finally:
        hub.close()


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (None, "cannot read"),
        (b"\xf5\x00", "not a text file"),
        (b"{", r"\.json5: not valid JSON: .* \(zenoh\.extra is JSON"),
        (b"[1]", "must hold one JSON object"),
        (b'{"nonsense": 1}', "not a Zenoh configuration"),
    ],
)
def test_a_broken_extra_file_is_one_clear_line(tmp_path, content, text):
    path = tmp_path / "extra.json5"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=text):
        open_bus(ZenohConfig(extra=str(path)), "gateway")


def test_endpoints_are_loopback_and_explicit_unless_changed():
    hub, planner = session_config(ZenohConfig(), "gateway"), session_config(ZenohConfig(), "planner")
    assert hub["listen"]["endpoints"] == ["tcp/127.0.0.1:7448"]
    assert hub["connect"]["endpoints"] == []
    assert planner["listen"]["endpoints"] == ["tcp/127.0.0.1:0"]
    assert planner["connect"]["endpoints"] == ["tcp/127.0.0.1:7448"]
    assert not hub["scouting"]["multicast"]["enabled"]
    remote = session_config(ZenohConfig(connect=("tls/10.0.0.1:7448",)), "planner")
    assert remote["listen"]["endpoints"] == [], "another computer is reached, not listened for"
