"""What the gateway says of itself: status, latency, and why it stops."""

from __future__ import annotations

from bisect import bisect_left, insort
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

from hil_gateway.bus.messages import Command, FailsafeAction, GatewayStatus
from hil_gateway.bus.topics import GATEWAY_STATUS
from hil_gateway.can_link import CanLink
from hil_gateway.gateway.act.actor import Actor
from hil_gateway.gateway.decide.decision import Decision, Situation
from hil_gateway.gateway.decide.failsafe import IN_EMERGENCY, TABLE
from hil_gateway.gateway.decide.race_control import missing_for_crank
from hil_gateway.gateway.perceive.frame_counts import FrameCounts
from hil_gateway.gateway.perceive.inbox import Inbox
from hil_gateway.gateway.perceive.vehicle_state import VehicleStateBuilder
from hil_gateway.process.processor_wait import LatelyLate, who_was_late

LATENCY_WINDOW = 1000
"""answers whose latency is kept: 50 s of commands at 20 Hz"""

OF_THE_PLANNER = ("command_dead", "command_stale", "plan_standing")
"""what is missing before arming while no planner plans"""
COMPILES = "the planner compiles what it plans with: half a minute the first time"


class Reporter:
    """Keeps what `GatewayStatus` says beyond the present period."""

    def __init__(self, mode: str, load: Callable[[], str]) -> None:
        """`load` says, when asked, how busy the computer is."""
        self._mode, self._load = mode, load
        self._latency_ms = Rolling(LATENCY_WINDOW)
        self._answered_seq: int | None = None
        self._lately = LatelyLate()
        self.why = ""
        """who was late, or what is wrong with the fixes, where that is why the car is being stopped"""
        self._detail = ""
        self._due_ns = 0
        self._seq = 0

    def note_change(
        self, situation: Situation, before: Decision, after: Decision, estimate_age_s: float, fixes: Mapping[str, str]
    ) -> None:
        """Who was late and how busy the computer is, or what is wrong with the fixes (`fixes`, by cause), where that is
        why the car is being stopped; once a period."""
        self._lately.note({**situation.conditions.measures, "estimate_age": estimate_age_s})
        if after.action is before.action:
            return
        late = who_was_late(after.failsafe.cause, self._lately.longest)
        self.why = fixes.get(after.failsafe.cause, late)
        self._detail = f"{late}; {self._load()}".removesuffix("; ") if late else self.why

    def measure_latency(self, now_ns: int, decision: Decision, command: Command | None) -> None:
        """CAN report in to the first command frame that answers it."""
        driving = decision.action is FailsafeAction.DRIVE
        if driving and command is not None and command.seq != self._answered_seq:
            self._answered_seq = command.seq
            self._latency_ms.add((now_ns - command.state_stamp_ns) / 1e6)

    def status(  # noqa: PLR0917 - parts of the gateway that have something to say
        self,
        situation: Situation,
        decision: Decision,
        builder: VehicleStateBuilder,
        link: CanLink,
        actor: Actor,
        inbox: Inbox,
    ) -> GatewayStatus | None:
        """The message, when it is due."""
        if situation.now_ns < self._due_ns:
            return None
        self._due_ns = situation.now_ns + GATEWAY_STATUS.period_ns
        self._seq += 1
        missing, before_crank = decision.failsafe.missing(situation.conditions), self._before_crank(situation, decision)
        return GatewayStatus(
            stamp_ns=situation.now_ns,
            seq=self._seq - 1,
            mode=self._mode,
            armed=decision.failsafe.armed,
            action=decision.action,
            cause=decision.cause,
            missing_for_arming=missing,
            advice=_advice(situation, inbox, crankable=not before_crank) if missing else {},
            missing_for_crank=before_crank,
            holding=decision.holding,
            **_of_the_bus(link, builder.counts),
            commands_sent=actor.sent,
            commands_limited=actor.limited,
            loop_latency_p50_ms=self._latency_ms.quantile(0.5),
            loop_latency_p99_ms=self._latency_ms.quantile(0.99),
            detail=self._detail,
            command_source=inbox.command_source,
            second_source=inbox.second_source,
        )

    def _before_crank(self, situation: Situation, decision: Decision) -> tuple[str, ...]:
        if self._mode != "armed":
            return ("mode_without_crank",)
        return missing_for_crank(decision.race_control.ct_state, situation.ladder)


def _of_the_bus(link: CanLink, counts: FrameCounts) -> dict[str, Any]:
    """What has come over it."""
    stats = link.stats()
    return {
        "bus": link.kind,
        "bus_state": str(stats.bus_state),
        "frames_received": counts.received,
        "frames_lost": counts.lost + stats.lost,
        "frames_unknown": counts.unknown,
        "frames_malformed": counts.malformed + stats.malformed,
        "counter_errors": counts.counter_errors,
    }


def _advice(situation: Situation, inbox: Inbox, *, crankable: bool) -> dict[str, str]:
    """What to do about what is missing for arming, where the table's words are not all."""
    remedies = {IN_EMERGENCY: "`hil gateway disarm`, then crank"}
    remedies |= {"car_not_driving": "the engine is off: `hil gateway crank`"} if crankable else {}
    compiles = dict.fromkeys(OF_THE_PLANNER if inbox.planner_starts(situation.now_ns) else (), COMPILES)
    return {**_of_who_speaks(situation, inbox), **situation.conditions.unready, **remedies, **compiles}


def _of_who_speaks(situation: Situation, inbox: Inbox) -> dict[str, str]:
    """Cause -> what is missing, without the remedy to start a process that speaks; with what its plans say of it."""
    waits = situation.conditions.unready.get("plan_standing", "")
    speak = {"estimator": ""} if inbox.estimate.alive(situation.now_ns) else {}
    speak |= {"planner": f": {waits}" if waits else ""} if inbox.plan.latest.alive(situation.now_ns) else {}
    return {row.cause: row.meaning + speak[row.awaits] for row in TABLE if row.awaits in speak}


class Rolling:
    """Quantiles of the newest `length` numbers, kept sorted: asking costs nothing, and is done ten times a second."""

    def __init__(self, length: int) -> None:
        self._length = length
        self._recent: deque[float] = deque()
        self._sorted: list[float] = []

    def add(self, value: float) -> None:
        """Take in a number; the oldest goes when there are too many."""
        if len(self._recent) == self._length:
            self._sorted.pop(bisect_left(self._sorted, self._recent.popleft()))
        self._recent.append(value)
        insort(self._sorted, value)

    def quantile(self, share: float) -> float | None:
        """The number that `share` of them are below; None before the first."""
        return self._sorted[min(int(share * len(self._sorted)), len(self._sorted) - 1)] if self._sorted else None
