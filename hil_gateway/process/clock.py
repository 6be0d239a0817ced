"""Time as an argument: only nodes hold a clock, everything below them is given `now_ns`.

All times inside the project are monotonic nanoseconds: ages survive a step of the wall clock. Two computers
never compare their clocks; a message is aged by the receiver's clock, and a command carries back the stamp
of the vehicle state it answers, so that the gateway ages it by its own.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol

NS_PER_S = 1_000_000_000
LOOK_NS = 200_000
"""between two looks for a message that is due"""
IDLE_NS = 1_000_000
"""between two looks where none is due"""


class Clock(Protocol):
    """Source of monotonic nanoseconds and of pauses."""

    def now_ns(self) -> int:
        """Current time, ns, never decreasing."""
        ...

    def sleep_until(self, t_ns: int) -> None:
        """Block until `t_ns`; returns at once when it has passed."""
        ...


class SystemClock:
    """CLOCK_MONOTONIC: shared by all processes of one computer."""

    def now_ns(self) -> int:
        return time.monotonic_ns()

    def sleep_until(self, t_ns: int) -> None:
        remaining = t_ns - time.monotonic_ns()
        if remaining > 0:
            time.sleep(remaining / NS_PER_S)


class VirtualClock:
    """Time that moves only when told to: tests, campaigns, replay."""

    def __init__(self, start_ns: int = 0) -> None:
        self._now_ns = start_ns

    def now_ns(self) -> int:
        return self._now_ns

    def sleep_until(self, t_ns: int) -> None:
        self._now_ns = max(self._now_ns, t_ns)

    def advance(self, duration_ns: int) -> None:
        """Move time forward by `duration_ns` >= 0."""
        if duration_ns < 0:
            raise ValueError(f"virtual time cannot go back: {duration_ns} ns")
        self._now_ns += duration_ns


def next_due(due_ns: int, now_ns: int, period_ns: int) -> int:
    """When the next period after the one due at `due_ns` begins that is still to come: those that were missed are left
    out, never caught up in a burst, and the others begin when they would have."""
    missed = max((now_ns - due_ns) // period_ns, 0)
    return due_ns + (missed + 1) * period_ns


def wall_offset_ns() -> int:
    """Nanoseconds to add to a monotonic stamp to get Unix time (for recordings and kernel time stamps)."""
    return time.time_ns() - time.monotonic_ns()


class Arrivals:
    """When to look again for messages that come every `period_ns`, on a bus that is only asked: often when one is due,
    seldom else."""

    def __init__(self, period_ns: int) -> None:
        self._before_ns = period_ns - 2 * IDLE_NS
        self._after_ns = period_ns + 2 * IDLE_NS
        self._last_ns: int | None = None

    def next_look_ns(self, now_ns: int, arrived: bool) -> int:
        """After a look at `now_ns` that found one or not."""
        if arrived:
            self._last_ns = now_ns
        if self._last_ns is None or now_ns > self._last_ns + self._after_ns:
            return now_ns + IDLE_NS
        return max(self._last_ns + self._before_ns, now_ns + LOOK_NS)


def wait_for(clock: Clock, arrived: Callable[[], bool], until_ns: int) -> bool:
    """Look until `arrived` says so or `until_ns` has passed; whether it has."""
    while not (found := arrived()) and clock.now_ns() < until_ns:
        clock.sleep_until(clock.now_ns() + LOOK_NS)
    return found
