"""What the event log compares from one period to the next, and the changes it makes of it. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

from hil_gateway.bus.event import EventKind, Severity
from hil_gateway.bus.messages import FailsafeAction, OperatorAction
from hil_gateway.car.states import (
    KILL_VEHICLE_FLAGS,
    STOP_TRACK_FLAGS,
    STOP_VEHICLE_FLAGS,
    CtState,
    SysState,
    TrackFlag,
    VehicleFlag,
)
from hil_gateway.gateway.check.arming import EXPLANATION
from hil_gateway.gateway.core import Gateway
from hil_gateway.gateway.decide.decision import STOPS
from hil_gateway.gateway.decide.failsafe import ROWS, Failsafe, Inputs

CAUSES_OF_OTHERS = {"disarmed_moving": "disarming was asked for while the car moved"}
"""causes that are no row of the failsafe table"""


@dataclass(frozen=True)
class Change:
    """An event without its stamp."""

    kind: EventKind
    before: str
    after: str
    text: str
    severity: Severity = Severity.INFO
    cause: str = ""
    measured: float | None = None
    limit: float | None = None
    unit: str = ""


class Seen(NamedTuple):
    """The gateway in one period; the defaults are those of one that has just started."""

    failsafe: Failsafe = Failsafe()
    ct_state: int = CtState.POWER_ON
    sys_state: int = 0
    track_flag: int = TrackFlag.NONE
    vehicle_flag: int = VehicleFlag.NONE
    bus_state: str = "error_active"
    why: str = ""
    """who was late, or what is wrong with the fixes, where that is why the car is being stopped"""
    second_computer: bool = False
    """another computer on this bus reports its ct_state"""
    command_source: str = ""
    """who has the right to command"""
    second_source: str = ""
    """who sends commands without it"""
    cause: str = ""
    """behind a stop, or behind an emergency while no drive commands are sent"""
    inputs: Inputs | None = None
    """of the decision, which are others in every period"""

    @classmethod
    def of(cls, now_ns: int, gateway: Gateway, bus_state: str) -> Seen | None:
        """None before its first period."""
        if gateway.seen is None:
            return None
        (state, inputs), decision = gateway.seen, gateway.decision
        return cls(
            failsafe=decision.failsafe,
            ct_state=decision.race_control.ct_state,
            sys_state=state.sys_state,
            track_flag=state.track_flag,
            vehicle_flag=state.vehicle_flag,
            bus_state=bus_state,
            why=gateway.why,
            second_computer=gateway.builder.another("reports", now_ns),
            command_source=gateway.inbox.command_source,
            second_source=gateway.inbox.second_source,
            cause=decision.cause,
            inputs=inputs,
        )


def changes(before: Seen, after: Seen) -> Iterator[Change]:
    """Everything that is different, what stops the car first."""
    asks_to_arm = after.inputs is not None and after.inputs.request is OperatorAction.ARM
    if before[:-1] == after[:-1] and not asks_to_arm:  # nearly always
        return
    if after.failsafe != before.failsafe:
        yield _failsafe(before.failsafe, after)
    elif after.cause != before.cause and after.cause:
        text = _why(after.cause, after.why)
        yield Change(EventKind.FAILSAFE, after.failsafe.action, "emergency", text, Severity.STOP, after.cause)
    elif after.inputs is not None and asks_to_arm:
        yield from _refusal(after.failsafe, after.inputs)
    if after.track_flag != before.track_flag:
        stop = after.track_flag in STOP_TRACK_FLAGS
        yield _named(EventKind.FLAG, TrackFlag, before.track_flag, after.track_flag, "track flag", stop=stop)
    if after.vehicle_flag != before.vehicle_flag:
        stop = after.vehicle_flag in STOP_VEHICLE_FLAGS | KILL_VEHICLE_FLAGS
        yield _named(EventKind.FLAG, VehicleFlag, before.vehicle_flag, after.vehicle_flag, "vehicle flag", stop=stop)
    if after.sys_state != before.sys_state:
        stop = after.sys_state in (SysState.EMERGENCY, SysState.CRITICAL_LIMIT)
        yield _named(EventKind.CAR, SysState, before.sys_state, after.sys_state, "sys_state of the car", stop=stop)
    if after.ct_state != before.ct_state:
        stop = after.ct_state == CtState.EMERGENCY
        yield _named(EventKind.LADDER, CtState, before.ct_state, after.ct_state, "ct_state of the computer", stop=stop)
    if after.bus_state != before.bus_state:
        worse = Severity.INFO if after.bus_state == "error_active" else Severity.WARNING
        yield Change(EventKind.BUS, before.bus_state, after.bus_state, "state of the CAN controller", worse)
    if after.second_computer and not before.second_computer:
        text = "another computer reports its ct_state: is a second gateway running?"
        yield Change(EventKind.BUS, "", "second computer", text, Severity.WARNING)
    if before.command_source and after.command_source != before.command_source:
        text = f"{after.command_source} has the right to command, and not {before.command_source} any more"
        yield Change(EventKind.PROCESS, before.command_source, after.command_source, text, Severity.WARNING)
    if after.second_source and after.second_source != before.second_source:
        yield _second_source(after)


def _second_source(seen: Seen) -> Change:
    text = f"commands of {seen.second_source} are refused: {seen.command_source} has the right to command"
    return Change(EventKind.PROCESS, "", "second source of commands", text, Severity.WARNING)


def _failsafe(before: Failsafe, after: Seen) -> Change:
    """Armed, disarmed, or a stop with what was measured against the row that fired."""
    now, inputs = after.failsafe, after.inputs
    if now.action in STOPS:
        row = ROWS.get(now.cause)
        held = inputs.measures.get(row.measure, math.inf) if row and inputs else math.inf
        measured = held if row and row.threshold_s > 0 and math.isfinite(held) else None
        limit = None if measured is None or row is None else row.threshold_s
        text = _why(now.cause, after.why)
        return Change(
            EventKind.FAILSAFE, before.action, now.action, text, Severity.STOP, now.cause, measured, limit,
            "" if measured is None else "s",
        )  # fmt: skip
    armed = now.action is FailsafeAction.DRIVE
    text = "armed by a person: commands drive the car" if armed else "disarmed: no commands are sent"
    return Change(EventKind.ARMING, before.action, now.action, text)


def _why(cause: str, more: str) -> str:
    words = ROWS[cause].meaning if cause in ROWS else CAUSES_OF_OTHERS.get(cause, cause)
    return f"{words} ({more})" if more else words


def _refusal(failsafe: Failsafe, inputs: Inputs) -> Iterator[Change]:
    """A request to arm that changed nothing."""
    if missing := failsafe.missing(inputs):
        words = inputs.unready.get(missing[0]) or EXPLANATION.get(missing[0], missing[0])
        text = f"arming refused: {words}"
        yield Change(EventKind.ARMING, failsafe.action, failsafe.action, text, Severity.WARNING, ", ".join(missing))


def _named(kind: EventKind, states: type[IntEnum], before: int, after: int, what: str, *, stop: bool) -> Change:
    names = _name(states, before), _name(states, after)
    return Change(kind, *names, text=f"{what} {after}", severity=Severity.STOP if stop else Severity.INFO)


def _name(states: type[IntEnum], number: int) -> str:
    return states(number).name.lower() if number in states.__members__.values() else str(number)
