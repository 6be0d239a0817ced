"""The event log of the loop: one typed entry for every change, published, and handed to whoever writes it down."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable
from dataclasses import asdict, replace
from itertools import chain

from hil_gateway.bus.event import Event, EventKind, Severity
from hil_gateway.bus.interface import Bus
from hil_gateway.bus.topics import EVENT
from hil_gateway.gateway.core import Gateway
from hil_gateway.gateway.events.change import Change, Seen, changes
from hil_gateway.gateway.events.others import OtherProcesses
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.process.lifecycle import EVENT_LINE

MOST_A_SECOND, MOST_A_MINUTE = 10, 60
"""entries of one kind: a fault that comes and goes must not fill the disk; the next entry counts the rest"""
JOURNAL_LEVEL = {Severity.INFO: 6, Severity.WARNING: 4, Severity.STOP: 2}
"""syslog levels (sd-daemon(3)): informational, warning, critical"""


class EventLog:
    """Compares the gateway and the other processes with the period before; `step` after every period of the gateway."""

    def __init__(self, bus: Bus, write: Callable[[Event], None] = lambda event: None) -> None:
        self._bus, self._write = bus, write
        self._others = OtherProcesses(bus)
        self._seen = Seen()
        self._recent: dict[EventKind, deque[int]] = {kind: deque(maxlen=MOST_A_MINUTE) for kind in EventKind}
        self._left_out = dict.fromkeys(EventKind, 0)
        self._seq = 0

    def step(self, now_ns: int, gateway: Gateway, bus_state: str = "error_active") -> None:
        """Publish and write down what is different since the last call."""
        found: list[Change] = []
        if (seen := Seen.of(now_ns, gateway, bus_state)) is not None:
            found, self._seen = list(changes(self._seen, seen)), seen
        for change in chain(found, self._others.step(now_ns, gateway.inbox.plan.latest)):
            self._publish(now_ns, change)

    def _publish(self, now_ns: int, change: Change) -> None:
        # stops are latched and so rare by themselves: none is ever left out
        if change.kind is not EventKind.FAILSAFE and self._too_many(change.kind, now_ns):
            self._left_out[change.kind] += 1
            return
        self._recent[change.kind].append(now_ns)
        if left_out := self._left_out[change.kind]:
            self._left_out[change.kind] = 0
            change = replace(change, text=f"{change.text} ({left_out} more in between not listed)")
        event = Event(stamp_ns=now_ns, seq=self._seq, **asdict(change))
        self._seq += 1
        self._bus.publish(EVENT, event)
        self._write(event)

    def _too_many(self, kind: EventKind, now_ns: int) -> bool:
        recent = self._recent[kind]
        limits = (MOST_A_SECOND, NS_PER_S), (MOST_A_MINUTE, 60 * NS_PER_S)
        return any(len(recent) >= most and now_ns - recent[-most] < within_ns for most, within_ns in limits)


def journal_line(event: Event) -> str:
    """An event as one line of the journal, with the level systemd sorts by where it listens."""
    level = f"<{JOURNAL_LEVEL[event.severity]}>" if "JOURNAL_STREAM" in os.environ else ""
    return f"{level}{EVENT_LINE}{event.line()}"
