"""The parts of a plan: each with its own time, and heard as between processes."""

from __future__ import annotations

from itertools import count

import pytest

from benchmarks.plans.plan_parts import BETWEEN, COLD, READY, REST, WHOLE, BytesBus, PartTimes, shares
from hil_gateway.bus.messages import Command
from hil_gateway.bus.topics import COMMAND


def test_the_time_of_a_part_does_not_count_for_the_part_around_it() -> None:
    ticks = count()
    times = PartTimes(lambda: next(ticks))
    times.plans.append({})

    def inner() -> None:
        next(ticks)

    timed_inner = times.timed("inner", inner)

    def outer() -> None:
        timed_inner()
        timed_inner()

    times.timed("outer", outer)()
    # a tick for each look at the clock: two for every part, one more inside each inner one
    assert times.plans == [{"inner": 4, "outer": 3}]
    assert sum(times.plans[0].values()) == 7


def test_a_part_that_fails_is_counted_and_its_error_passed_on() -> None:
    ticks = count()
    times = PartTimes(lambda: next(ticks))
    times.plans.append({})

    def fails() -> None:
        raise ValueError("bad")

    with pytest.raises(ValueError, match="bad"):
        times.timed("fails", fails)()
    assert times.plans == [{"fails": 1}]


@pytest.mark.parametrize("outside", [READY, BETWEEN])
def test_a_part_of_the_preparation_counts_as_preparation(outside: str) -> None:
    ticks = count()
    times = PartTimes(lambda: next(ticks))
    times.plans.append({})
    shift = times.timed("parameters", lambda: None)
    times.timed(outside, shift)()
    shift()
    assert times.plans == [{outside: 3, "parameters": 1}]


def test_what_is_done_before_and_between_plans_is_no_part_of_the_whole_and_shares_add_up() -> None:
    times = PartTimes(lambda: 0)
    plan = {"solver": 2_000_000, REST: 1_000_000, READY: 4_000_000, BETWEEN: 5_000_000}
    times.plans = [plan for _ in range(COLD + 10)]
    rows = {row["part"]: row for row in shares(times)}
    assert rows[WHOLE]["p50_ms"] == 3.0
    assert rows["solver"]["share"] == pytest.approx(2 / 3, abs=1e-3)
    inside = [row["share"] for name, row in rows.items() if name not in (WHOLE, READY, BETWEEN)]
    assert sum(float(share) for share in inside) == pytest.approx(1.0, abs=2e-3)


def test_messages_are_bytes_on_the_way() -> None:
    bus = BytesBus()
    heard = bus.subscribe(COMMAND)
    sent = Command(stamp_ns=1, seq=2, source="planner", state_stamp_ns=0, steer=0.01, drive=0.1)
    bus.publish(COMMAND, sent)
    received = heard.poll(0)
    assert received == [sent]
    assert received[0] is not sent
