"""Bus and ages: bounded, newest wins, and nothing old is ever called alive."""

from __future__ import annotations

import pytest

from hil_gateway.bus.interface import LatestReader, LocalBus
from hil_gateway.bus.messages import Command, OperatorAction, OperatorCommand
from hil_gateway.bus.topics import COMMAND, OPERATOR, TOPICS
from hil_gateway.process.clock import NS_PER_S, VirtualClock


def _command(seq: int) -> Command:
    return Command(stamp_ns=seq, seq=seq, source="test", state_stamp_ns=0, steer=0.1, drive=0.0)


def test_queue_keeps_the_newest_and_counts_what_it_dropped() -> None:
    bus = LocalBus()
    queue = bus.subscribe(COMMAND, depth=3)
    for seq in range(5):
        bus.publish(COMMAND, _command(seq))
    assert [m.seq for m in queue.poll(0)] == [2, 3, 4]
    assert queue.dropped == 2
    assert queue.poll(0) == []


def test_message_older_than_its_deadline_is_not_alive() -> None:
    bus, clock = LocalBus(), VirtualClock()
    reader = LatestReader(bus, COMMAND)
    assert not reader.update(clock.now_ns()).alive(clock.now_ns())
    bus.publish(COMMAND, _command(1))
    assert reader.update(clock.now_ns()).alive(clock.now_ns())
    clock.advance(int(COMMAND.deadline_s * NS_PER_S))
    assert reader.update(clock.now_ns()).alive(clock.now_ns())
    clock.advance(1)
    assert not reader.update(clock.now_ns()).alive(clock.now_ns())


def test_topics_do_not_mix() -> None:
    bus = LocalBus()
    commands = bus.subscribe(COMMAND)
    bus.publish(OPERATOR, OperatorCommand(stamp_ns=0, seq=0, source="test", action=OperatorAction.ARM))
    assert commands.poll(0) == []


def test_topic_keys_are_unique_and_deadlines_cover_at_least_one_period() -> None:
    assert len({topic.key for topic in TOPICS}) == len(TOPICS)
    assert all(topic.deadline_s * topic.rate_hz >= 1 for topic in TOPICS if topic.rate_hz)


def test_virtual_time_never_goes_back() -> None:
    clock = VirtualClock(10)
    clock.sleep_until(5)
    assert clock.now_ns() == 10
    with pytest.raises(ValueError, match="cannot go back"):
        clock.advance(-1)
