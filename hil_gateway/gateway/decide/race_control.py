"""Race control: the ct_state ladder, flags, heartbeat and acknowledgements (docs/failsafe.md).

`ct_state` is what the computer says, `sys_state` what the car says; each moves one rung when it sees the other's.
Pure: ages and values are arguments, time is an argument.
"""

from __future__ import annotations

from typing import NamedTuple

from hil_gateway.car.states import (
    DRIVING,
    KILL_VEHICLE_FLAGS,
    STOP_VEHICLE_FLAGS,
    CtState,
    SysState,
    TrackFlag,
    under_yellow,
)
from hil_gateway.gateway.decide.failsafe import IN_EMERGENCY
from hil_gateway.process.clock import NS_PER_S

HEARTBEAT_TIMEOUT_S = 0.5


class LadderInputs(NamedTuple):
    """What race control and the car said last."""

    car_alive: bool
    sys_state: int
    mode_switch: bool
    heartbeat: int
    heartbeat_age_s: float
    """age of the newest heartbeat frame"""
    track_flag: int
    vehicle_flag: int
    rungs: frozenset[int] = frozenset(SysState)
    """states that the car's ladder has"""

    def has_reached(self, sys_state: int, needed: SysState) -> bool:
        """Whether the car is as far as `needed`, or as the state before it where its ladder lacks that."""
        known = max((rung for rung in self.rungs if rung <= needed), default=needed)
        return known <= sys_state <= SysState.DRIVING


class Demand(NamedTuple):
    """What the failsafe asks of the ladder."""

    stop: bool = False
    emergency: bool = False
    restart: bool = False
    """start over, and wait for the car to do so too"""
    armed: bool = False
    highest: CtState = CtState.NOMINAL_RACE
    """rung the ladder is not climbed beyond"""
    crank: bool = False
    """a person asks for it in this very period, or the mode sends nothing and so cranks nothing"""


class RaceControl(NamedTuple):
    """State of the ladder; `step` returns the next one."""

    ct_state: CtState = CtState.POWER_ON
    heartbeat: int = -1
    beat_ns: int | None = None
    """when the heartbeat last changed"""

    def step(self, now_ns: int, inputs: LadderInputs, demand: Demand) -> RaceControl:
        """At most one rung a call."""
        beats = inputs.heartbeat_age_s <= HEARTBEAT_TIMEOUT_S and inputs.heartbeat != self.heartbeat
        seen = RaceControl(self.ct_state, inputs.heartbeat, now_ns) if beats else self
        alive = seen.heartbeat_frozen_s(now_ns) < HEARTBEAT_TIMEOUT_S
        return RaceControl(_next(self.ct_state, inputs, demand, alive), seen.heartbeat, seen.beat_ns)

    def heartbeat_frozen_s(self, now_ns: int) -> float:
        """Seconds since race control's heartbeat last changed; infinite before the first."""
        return float("inf") if self.beat_ns is None else (now_ns - self.beat_ns) / NS_PER_S


def _next(ct: CtState, inputs: LadderInputs, demand: Demand, heartbeat: bool) -> CtState:  # noqa: PLR0911 (one rung a line)
    sys_state = inputs.sys_state if inputs.car_alive else 0
    if demand.emergency:
        return CtState.EMERGENCY
    if demand.restart:
        return CtState.INIT
    if ct is CtState.EMERGENCY:
        return ct
    if demand.stop and ct >= CtState.INIT_DRIVING:
        return CtState.COORDINATED_STOP
    if ct is CtState.COORDINATED_STOP:
        return _pace(inputs) if demand.armed else ct
    if ct in DRIVING:
        return _pace(inputs)
    if ct is CtState.INIT_DRIVING:
        return _pace(inputs) if sys_state == SysState.DRIVING else ct
    if ct is CtState.CRANK_READY and not demand.crank:
        return ct
    return CtState(ct + 1) if ct < demand.highest and _may_climb(ct, sys_state, inputs, heartbeat) else ct


def missing_for_crank(ct: CtState, inputs: LadderInputs) -> tuple[str, ...]:
    """Why a request to crank would be refused now."""
    if ct is CtState.EMERGENCY:
        return (IN_EMERGENCY,)
    if ct > CtState.CRANK_READY:
        return ("cranked",)
    sys_state = inputs.sys_state if inputs.car_alive else 0
    answered = ct is CtState.CRANK_READY and SysState.CRANK_READY <= sys_state <= SysState.DRIVING
    ladder = () if answered else ("car_not_crank_ready",)
    return ladder + (() if inputs.mode_switch else ("mode_switch_off",))


def _may_climb(ct: CtState, sys_state: int, inputs: LadderInputs, heartbeat: bool) -> bool:
    """Whether the car has answered this rung."""
    if ct is CtState.RACE_READY:
        return heartbeat and sys_state in (SysState.IDLE, SysState.DRIVING) and _released(inputs)
    needed = {
        CtState.POWER_ON: SysState.POWER_ON,
        CtState.INIT: SysState.CONNECTED,
        CtState.ACTUATOR_TEST: SysState.TEST_DONE,
        CtState.CRANK_READY: SysState.CRANK_READY,
        CtState.CRANKING: SysState.IDLE,
    }.get(ct)
    if needed is None or not inputs.has_reached(sys_state, needed):
        return False
    return inputs.mode_switch or ct is not CtState.CRANK_READY


def _released(inputs: LadderInputs) -> bool:
    """Flags under which the car may start to drive."""
    go = inputs.track_flag in (TrackFlag.GREEN, TrackFlag.FULL_COURSE_YELLOW)
    return go and inputs.vehicle_flag not in STOP_VEHICLE_FLAGS | KILL_VEHICLE_FLAGS


def _pace(inputs: LadderInputs) -> CtState:
    return CtState.CAUTION if under_yellow(inputs.track_flag, inputs.vehicle_flag) else CtState.NOMINAL_RACE
