"""Which commands are believed: one source at a time, in order, and about a recent state.

A person takes over by a joystick at once, and by a request gives the right to the sender that is refused.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from hil_gateway.bus.messages import Command, FailsafeAction
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.settings.gateway import PERIOD_NS

SOURCE_TIMEOUT_S = 0.5
"""A source silent for so long may start over, but not while it drives the car, and be replaced while disarmed."""

EARLIER_NS = 3 * PERIOD_NS // 4
"""by which a command may come earlier than an interval after one that was taken late, in the period after its own"""


class Refusal(StrEnum):
    """Why a command was not taken."""

    SECOND_SOURCE = "second_source"
    OUT_OF_ORDER = "out_of_order"
    STALE = "stale"
    FROM_THE_FUTURE = "from_the_future"


@dataclass(slots=True)
class CommandGate:
    """Holds the newest believed command and its time of receipt."""

    latency_max_s: float
    newest: Command | None = None
    received_ns: int | None = None
    successor: str = ""
    """a source that a person has given the right to; empty: nobody is to follow"""
    by_hand: bool = False
    """whether the newest is a person's"""
    interval_ns: int | None = None
    """between the two newest, ns"""

    def offer(self, command: Command, now_ns: int, action: FailsafeAction, *, by_hand: bool = False) -> Refusal | None:
        """Take `command` or say why not; one `by_hand` takes over from any source but another person."""
        known = self.newest
        silent = self.age_s(now_ns) > SOURCE_TIMEOUT_S
        if known is not None and not (silent and action is FailsafeAction.SILENT):
            same = command.source == known.source
            takes_over = (by_hand and not self.by_hand) or command.source == self.successor
            if not (same or takes_over):
                return Refusal.SECOND_SOURCE
            starts_over = silent and action is not FailsafeAction.DRIVE
            earlier = command.seq <= known.seq or command.state_stamp_ns < known.state_stamp_ns
            if same and earlier and not starts_over:
                return Refusal.OUT_OF_ORDER
        if command.state_stamp_ns > now_ns:
            return Refusal.FROM_THE_FUTURE
        if now_ns - command.state_stamp_ns > self.latency_max_s * NS_PER_S:
            return Refusal.STALE
        self.interval_ns = None if self.received_ns is None else now_ns - self.received_ns
        self.newest, self.received_ns, self.by_hand = command, now_ns, by_hand
        self.successor = "" if command.source == self.successor else self.successor
        return None

    def expects(self, now_ns: int) -> bool:
        """Whether the next command is due in this period, if they come as regularly as the last two."""
        if self.received_ns is None or self.interval_ns is None:
            return False
        return now_ns - self.received_ns > self.interval_ns - EARLIER_NS

    def age_s(self, now_ns: int) -> float:
        """Seconds since the newest believed command arrived; infinite before the first."""
        return float("inf") if self.received_ns is None else (now_ns - self.received_ns) / NS_PER_S
