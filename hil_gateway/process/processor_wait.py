"""Who was late, for how long, and whether the computer was too busy: what a stop for lateness has to say.

The gateway sees when each link of the loop last spoke, and not whether one that is silent runs.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from hil_gateway.process.figures import figure

TIMING_CAUSES = frozenset(
    {"gateway_late", "command_stale", "command_dead", "can_silent", "state_invalid", "estimate_invalid"}
)
"""rows of the failsafe table that a busy computer can make fire"""


@dataclass(frozen=True)
class Link:
    """One part of the loop, what is missing when it is late, and how long that is usual, s."""

    process: str
    measure: str
    missing: str
    usual_s: float


CHAIN = (
    Link("gateway", "gateway_gap", "its period did not run", 0.03),  # three periods of 10 ms
    Link("car or plant", "can_silence", "no CAN frame", 0.05),  # five of its 100 Hz frames
    Link("estimator", "estimate_age", "no estimate", 0.05),  # five periods
    Link("planner", "command_age", "no command", 0.075),  # one and a half plans of 50 ms
)
"""in the order of the data: who is late makes those behind it late"""
LATELY = 20
"""periods of the gateway (0.2 s): a row of lateness has held for up to 0.1 s when it fires, and what it waits for is
one or two periods behind whoever was late"""


class LatelyLate:
    """The longest each link has been silent within the last `LATELY` periods: whoever was late may speak again when
    the stop begins."""

    def __init__(self) -> None:
        self._kept: deque[tuple[float, ...]] = deque(maxlen=LATELY)

    def note(self, measures: Mapping[str, float]) -> None:
        """Silence of each link in this period, s, by the names in `CHAIN`; once a period."""
        self._kept.append(tuple(measures.get(link.measure, 0.0) for link in CHAIN))

    @property
    def longest(self) -> dict[str, float]:
        """Measure -> s."""
        return {link.measure: max(held) for link, held in zip(CHAIN, zip(*self._kept, strict=True), strict=True)}


def who_was_late(cause: str, measures: Mapping[str, float]) -> str:
    """The links that had not spoken for longer than usual before a stop for `cause` began; empty: it was not lateness.

    `measures` in seconds, by the names in `CHAIN`; one that has never spoken (infinite) is not late but absent.
    """
    if cause not in TIMING_CAUSES:
        return ""
    late = [(link, measures.get(link.measure, 0.0)) for link in CHAIN]
    return ", ".join(
        f"{link.process} late: {link.missing} for {figure(1e3 * held_s, 'ms', 3)}"
        for link, held_s in late
        if link.usual_s < held_s < float("inf")
    )


@dataclass(frozen=True)
class Load:
    """How much this computer has to do."""

    average: float
    """tasks that ran or waited, mean over a minute"""
    ready: int
    """tasks that run or wait now"""
    processors: int

    def __str__(self) -> str:
        return f"load {figure(self.average, digits=2)}, {self.ready} tasks ready on {self.processors} processors"

    @property
    def remedy(self) -> str:
        """What would help."""
        if max(self.average, self.ready) <= self.processors:
            return "the computer is not busy: see the log of that process"
        return "if it runs, end other programs, or permit real-time priority (`hil doctor` says how)"


def read_load() -> Load:
    """From proc(5), loadavg."""
    words = Path("/proc/loadavg").read_text().split()
    return Load(float(words[0]), int(words[3].partition("/")[0]), len(os.sched_getaffinity(0)))


def describe_load() -> str:
    """Load and remedy, to go behind who was late."""
    load = read_load()
    return f"{load}: {load.remedy}"
