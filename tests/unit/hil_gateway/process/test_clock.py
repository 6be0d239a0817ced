"""A message that is due is looked for often, one that is not seldom."""

from __future__ import annotations

from hil_gateway.process.clock import Arrivals, VirtualClock, wait_for

MS = 1_000_000


def looks(sent_ns: list[int], until_ns: int) -> list[tuple[int, bool]]:
    """When a reader of messages every 10 ms looked, and what it found."""
    arrivals, now_ns, found = Arrivals(10 * MS), 0, []
    waiting = list(sent_ns)
    while now_ns < until_ns:
        arrived = bool(waiting) and waiting[0] <= now_ns
        waiting = [stamp for stamp in waiting if stamp > now_ns]
        found.append((now_ns, arrived))
        now_ns = arrivals.next_look_ns(now_ns, arrived)
    return found


def test_regular_messages_are_found_within_a_look_and_with_few_of_them() -> None:
    sent = [k * 10 * MS + 300_000 * (k % 3) for k in range(1, 101)]
    found = looks(sent, 1010 * MS)
    late = [when - stamp for when, stamp in zip((w for w, arrived in found if arrived), sent, strict=True)]
    assert max(late[2:]) < 0.2 * MS + 1
    assert len(found) < 1600


def test_silence_is_looked_into_once_a_millisecond() -> None:
    assert len(looks([5 * MS], 1000 * MS)) < 1030


def test_waiting_ends_with_what_is_waited_for_or_in_time() -> None:
    clock = VirtualClock()
    assert wait_for(clock, lambda: clock.now_ns() >= MS, 5 * MS)
    assert MS <= clock.now_ns() < 1.3 * MS
    assert not wait_for(clock, lambda: False, 5 * MS)
    assert 5 * MS <= clock.now_ns() < 5.3 * MS
