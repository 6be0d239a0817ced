"""When a period begins, and that what answers its reports leaves in the same one."""

from __future__ import annotations

import random

import pytest
from support.cars.scripted_car import Rig

from hil_gateway.bus import topics
from hil_gateway.bus.messages import FailsafeAction, OperatorAction
from hil_gateway.gateway.period import next_period

MS = 1_000_000


@pytest.mark.parametrize("phase_ms", [0.0, 0.5, 1.5, 3.0, 5.9, 6.1, 9.9])
def test_periods_move_to_1_ms_after_the_reports_and_counters_keep_their_rate(phase_ms: float) -> None:
    """Reports come every 10 ms with a jitter of 0.3 ms; the period reads what came before it."""
    rng = random.Random(1)
    due_ns, ages, gaps = 10**9, [], []
    for _ in range(1000):
        now_ns = due_ns + rng.randrange(100_000)
        _, offset = divmod(now_ns - round(phase_ms * MS), 10 * MS)
        late_ns = rng.randrange(300_000)
        ages.append(offset - late_ns if offset >= late_ns else offset + 10 * MS - late_ns)
        following_ns = next_period(due_ns, now_ns + 2 * MS, ages[-1])
        gaps.append(following_ns - due_ns)
        due_ns = following_ns
    assert all(0.5 * MS < age < 1.5 * MS for age in ages[300:])
    assert all(abs(gap - 10 * MS) <= 20_000 for gap in gaps)


def test_missed_periods_are_left_out() -> None:
    assert next_period(0, 9 * MS, MS) == 10 * MS
    assert next_period(0, 10 * MS, MS) == 20 * MS
    assert next_period(0, 47 * MS, MS) == 50 * MS


def observed(rig: Rig) -> int:
    """The first phase of a period; stamp of the state it published."""
    rig.car.step(rig.now_ns)
    rig.gateway.observe(rig.now_ns)
    return rig.states.poll(rig.now_ns)[-1].stamp_ns


def test_a_command_that_answers_a_period_s_reports_leaves_in_it() -> None:
    rig = Rig()
    rig.drive_off()
    rig.planner_runs = False
    rig.run(0.03)
    state_ns = observed(rig)
    assert rig.gateway.awaits_command and not rig.gateway.has_command(rig.now_ns), "one is due"
    rig.clock.advance(5 * MS)
    rig.steer = 0.1
    rig.bus.publish(topics.COMMAND, rig.command(state_ns))
    assert rig.gateway.has_command(rig.now_ns)
    before = len(rig.frames())
    rig.gateway.answer(rig.now_ns)
    assert rig.applied_in.poll(0)[-1].steer > 0.0
    rig.car.step(rig.now_ns)
    assert {stamp for stamp, _ in rig.frames()[before:]} == {rig.now_ns} and len(rig.frames()) == before + 4


def test_a_stop_and_a_period_without_a_command_wait_for_nobody() -> None:
    rig = Rig()
    rig.drive_off()  # the last command came four periods ago: the next is due in the one after this
    rig.step()
    observed(rig)
    assert rig.gateway.has_command(rig.now_ns)
    rig.gateway.answer(rig.now_ns)
    rig.ask(OperatorAction.STOP)
    rig.clock.advance(10 * MS)
    observed(rig)
    assert rig.action is FailsafeAction.CONTROLLED_STOP and not rig.gateway.awaits_command
