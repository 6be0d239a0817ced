"""How long each process of the demo waited for a processor around a stop, by the kernel's own account."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from hil_gateway.process.clock import NS_PER_S
from hil_gateway.process.figures import figure
from hil_gateway.process.processor_wait import ProcessorTime, describe_load, processor_time

BEFORE_NS, AFTER_NS = 2 * NS_PER_S, NS_PER_S // 2
"""the account around a stop: what led to it, and waits that are entered only when they end"""
NOTABLE_S = 0.05
"""half of the shortest wait that stops the car"""


@dataclass(frozen=True)
class Account:
    """Seconds each process computed and waited within `window_s`."""

    window_s: float
    times: Mapping[str, ProcessorTime]
    load: str

    def __str__(self) -> str:
        if not self.times:
            return ""
        name = max(self.times, key=lambda n: self.times[n].waited_s)
        waited_s = self.times[name].waited_s
        window = figure(self.window_s, "s", 2)
        if waited_s >= NOTABLE_S:
            return f"{name} waited {figure(waited_s, 's', 2)} of {window} for a processor; {self.load}"
        busiest = max(self.times, key=lambda n: self.times[n].computed_s)
        computed = figure(self.times[busiest].computed_s, "s", 2)
        return f"no process waited for a processor; {busiest} computed {computed} of {window}"

    def as_json(self) -> dict[str, Any]:
        """For the summary."""
        waited = {name: time.waited_s for name, time in self.times.items()}
        return {"window_s": self.window_s, "waited_s": waited, "text": str(self)}


class Waiting:
    """Samples the account every period, and closes it a little after the stop began."""

    def __init__(self) -> None:
        self._samples: deque[tuple[int, dict[str, ProcessorTime]]] = deque()
        self._due_ns: int | None = None
        self.account: Account | None = None

    def update(self, now_ns: int, pids: Mapping[str, int]) -> bool:
        """Take a sample; whether the account has just been closed."""
        if self.account is not None:
            return False
        read = {name: time for name, pid in pids.items() if (time := processor_time(pid)) is not None}
        self._samples.append((now_ns, read))
        while now_ns - self._samples[0][0] > BEFORE_NS + AFTER_NS:
            self._samples.popleft()
        if self._due_ns is None or now_ns < self._due_ns:
            return False
        self.close()
        return True

    def stop_began(self, now_ns: int) -> None:
        """A stop for lateness has begun; later ones follow from it."""
        self._due_ns = self._due_ns or now_ns + AFTER_NS

    def close(self) -> None:
        """Make the account of a stop, if there was one and it is not made yet."""
        if self._due_ns is None or self.account is not None or not self._samples:
            return
        (start_ns, first), (end_ns, last) = self._samples[0], self._samples[-1]
        times = {name: _between(first[name], last[name]) for name in last if name in first}
        self.account = Account((end_ns - start_ns) / NS_PER_S, times, describe_load())


def _between(first: ProcessorTime, last: ProcessorTime) -> ProcessorTime:
    return ProcessorTime(last.computed_s - first.computed_s, last.waited_s - first.waited_s)
