"""One entry of the event log: something of the loop changed, with its cause, and the value and limit behind it."""

from __future__ import annotations

from enum import StrEnum
from typing import Any

from pydantic import Field

from hil_gateway.bus.messages import Message, Parameter, Text
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.process.figures import figure, printable


class EventKind(StrEnum):
    """What changed."""

    FAILSAFE = "failsafe"
    ARMING = "arming"
    LADDER = "ladder"
    CAR = "car"
    FLAG = "flag"
    BUS = "bus"
    ALERT = "alert"
    REVISION = "revision"
    ADOPTION = "adoption"
    LEARNING = "learning"
    LAP = "lap"
    PLAN = "plan"
    PROCESS = "process"
    RECEIVER = "receiver"


class Severity(StrEnum):
    """How urgent it is, in rising order."""

    INFO = "info"
    WARNING = "warning"
    STOP = "stop"


class Event(Message):
    """One change of the loop, as the gateway saw it."""

    kind: EventKind
    severity: Severity
    before: Text = Field(description="what held until now; empty where nothing did")
    after: Text = Field(description="what holds from now on")
    cause: Text = Field(default="", description="row of the failsafe table, effect or request behind it")
    measured: Parameter | None = Field(default=None, description="value that led to it; null where none was measured")
    limit: Parameter | None = Field(default=None, description="what the value is held against; null where nothing is")
    unit: Text = Field(default="", description="of both")
    text: Text = Field(description="the change in words, for people")

    def entry(self, zero_ns: int) -> dict[str, Any]:
        """The event as summaries and pages have it: its fields, and `t` in s after `zero_ns`."""
        tree = self.model_dump(mode="json", exclude={"stamp_ns", "seq"})
        return {"t": round((self.stamp_ns - zero_ns) / NS_PER_S, 3), **tree}

    def line(self) -> str:
        """The event in one line, for a log: `failsafe drive -> controlled_stop [command_stale]: ..., 0.11 s`."""
        change = f"{self.before} -> {self.after}" if self.before else self.after
        cause = f" [{self.cause}]" if self.cause else ""
        value = "" if self.measured is None else f", {figure(self.measured, self.unit, 3)}"
        limit = "" if self.limit is None else f" (limit {figure(self.limit, self.unit, 3)})"
        return printable(f"{self.kind} {change}{cause}: {self.text}{value}{limit}")
