"""Commands carry sequence, time and source: stale, repeated, late and second-source ones are refused."""

from __future__ import annotations

import random

import pytest

from hil_gateway.bus.messages import Command, FailsafeAction
from hil_gateway.gateway.command_gate import CommandGate, Refusal

MS = 1_000_000
DRIVE, STOP, SILENT = FailsafeAction.DRIVE, FailsafeAction.CONTROLLED_STOP, FailsafeAction.SILENT


def command(seq: int, state_ms: float, source: str = "planner") -> Command:
    return Command(
        stamp_ns=int(state_ms * MS), seq=seq, source=source, state_stamp_ns=int(state_ms * MS), steer=0.0, drive=0.0
    )


@pytest.fixture
def gate() -> CommandGate:
    fresh = CommandGate(latency_max_s=0.15)
    assert fresh.age_s(0) == float("inf")
    assert fresh.offer(command(10, 990), 1000 * MS, DRIVE) is None
    assert fresh.age_s(1100 * MS) == pytest.approx(0.1)
    return fresh


@pytest.mark.parametrize(
    ("offered", "now_ms", "action", "refusal"),
    [
        (command(11, 1000), 1010, DRIVE, None),
        (command(11, 990), 1010, DRIVE, None),  # two answers to one state
        (command(10, 1000), 1010, DRIVE, Refusal.OUT_OF_ORDER),
        (command(9, 1000), 1010, DRIVE, Refusal.OUT_OF_ORDER),
        (command(11, 989), 1010, DRIVE, Refusal.OUT_OF_ORDER),
        (command(11, 1000, "rogue"), 1010, DRIVE, Refusal.SECOND_SOURCE),
        (command(11, 1000, "rogue"), 1010, SILENT, Refusal.SECOND_SOURCE),
        (command(11, 1000), 1150, DRIVE, None),
        (command(11, 1000), 1151, DRIVE, Refusal.STALE),
        (command(11, 1011), 1010, DRIVE, Refusal.FROM_THE_FUTURE),
        (command(1, 1900), 2000, DRIVE, Refusal.OUT_OF_ORDER),  # a planner that restarted, while the other drives
        (command(1, 1400), 1500, SILENT, Refusal.OUT_OF_ORDER),
        (
            command(1, 1401),
            1501,
            False,
            None,
        ),  # silent for longer than 0.5 s, in a stop or disarmed
        (command(1, 1900, "other"), 2000, SILENT, None),
        (command(1, 1900, "other"), 2000, DRIVE, Refusal.SECOND_SOURCE),
    ],
)
def test_what_is_refused(gate, offered, now_ms, action, refusal):
    assert gate.offer(offered, now_ms * MS, action) == refusal
    taken = gate.newest is offered
    assert taken == (refusal is None)
    assert (gate.received_ns == now_ms * MS) == taken


@pytest.mark.parametrize(
    ("taken_ms", "expected_ms"),
    [
        ([], []),
        ([6], []),  # one says nothing of the next
        ([6, 56], [95 + 10]),  # in the fifth period after it, not before
        ([10, 60], [95 + 10]),  # too late for its period, taken in the next one: due in the fourth after that
        ([5, 15], [25, 35]),
    ],
)
def test_a_command_is_expected_when_the_interval_of_the_last_two_is_over(
    taken_ms: list[int], expected_ms: list[int]
) -> None:
    """Asked 5 ms after the beginning of every period."""
    gate = CommandGate(0.15)
    for seq, ms in enumerate(taken_ms):
        assert gate.offer(command(seq, ms), ms * MS, DRIVE) is None
    asked_ms = range((max(taken_ms, default=0) // 10) * 10 + 15, 10**3, 10)
    assert [ms for ms in asked_ms if gate.expects(ms * MS)][: len(expected_ms)] == expected_ms


def test_a_person_takes_over_at_once_and_from_no_other_person(gate):
    assert gate.offer(command(1, 1000, "joystick 1"), 1010 * MS, DRIVE, by_hand=True) is None
    assert gate.offer(command(12, 1005), 1020 * MS, DRIVE) is Refusal.SECOND_SOURCE
    assert gate.offer(command(1, 1005, "joystick 2"), 1020 * MS, DRIVE, by_hand=True) is Refusal.SECOND_SOURCE
    assert gate.offer(command(1, 1010, "joystick 1"), 1020 * MS, DRIVE, by_hand=True) is Refusal.OUT_OF_ORDER


def test_a_successor_follows_once_and_what_it_followed_is_refused(gate):
    gate.successor = "planner 2"
    assert gate.offer(command(11, 1000), 1010 * MS, DRIVE) is None
    assert gate.offer(command(1, 1005, "planner 2"), 1020 * MS, DRIVE) is None
    assert gate.offer(command(12, 1010), 1030 * MS, DRIVE) is Refusal.SECOND_SOURCE
    assert gate.successor == ""


def test_sequence_numbers_of_taken_commands_only_rise():
    rng = random.Random(5)
    gate, taken = CommandGate(0.15), []
    for now_ms in range(1000, 6000):
        offered = command(rng.randrange(now_ms - 50, now_ms + 5), now_ms - rng.randrange(0, 300), rng.choice("ab"))
        if gate.offer(offered, now_ms * MS, DRIVE) is None:
            taken.append(offered)
    assert len(taken) > 150
    assert [c.seq for c in taken] == sorted({c.seq for c in taken})
    assert len({c.source for c in taken}) == 1
