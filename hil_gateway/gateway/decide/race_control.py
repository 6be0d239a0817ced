"""Race control: the ct_state ladder, flags, heartbeat and acknowledgements (docs/failsafe.md).

`ct_state` is what the computer says, `sys_state` what the car says; each moves one rung when it sees the other's.
Pure: ages and values are arguments, time is an argument.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum

from hil_gateway.process.clock import NS_PER_S


class CtState(IntEnum):
    """What the computer reports."""

    POWER_ON = 1
    INIT = 2
    ACTUATOR_TEST = 3
    CRANK_READY = 4
    CRANKING = 5
    RACE_READY = 6
    INIT_DRIVING = 7
    CAUTION = 8
    NOMINAL_RACE = 9
    COORDINATED_STOP = 10
    CONTROLLED_SHUTDOWN = 11
    EMERGENCY = 12


class SysState(IntEnum):
    """What the car reports; the numbers the gateway compares with."""

    POWER_ON = 1
    CONNECTED = 2
    TEST_DONE = 4
    CRANK_READY = 5
    IDLE = 8
    DRIVING = 9
    SHUT_ENGINE = 10
    EMERGENCY = 16
    CRITICAL_LIMIT = 18


class TrackFlag(IntEnum):
    """Flag shown to everybody."""

    NONE = 0
    GREEN = 1
    RED = 3
    CHECKERED = 4
    FULL_COURSE_YELLOW = 9


class VehicleFlag(IntEnum):
    """Flag shown to this car."""

    NONE = 0
    BLACK = 4
    YELLOW = 7
    PURPLE = 32
    E_KILL = 33
    STOP = 34


STOP_TRACK_FLAGS = frozenset({TrackFlag.RED, TrackFlag.CHECKERED})
STOP_VEHICLE_FLAGS = frozenset({VehicleFlag.BLACK, VehicleFlag.STOP})
KILL_VEHICLE_FLAGS = frozenset({VehicleFlag.PURPLE, VehicleFlag.E_KILL})
DRIVING = frozenset({CtState.CAUTION, CtState.NOMINAL_RACE})
HEARTBEAT_TIMEOUT_S = 0.5


@dataclass(frozen=True, slots=True)
class Heard:
    """What race control and the car said last."""

    car_alive: bool
    sys_state: int
    mode_switch: bool
    heartbeat: int
    heartbeat_age_s: float
    """age of the newest heartbeat frame"""
    track_flag: int
    vehicle_flag: int


@dataclass(frozen=True, slots=True)
class Demand:
    """What the failsafe asks of the ladder."""

    stop: bool = False
    emergency: bool = False
    restart: bool = False
    """disarmed by a person at standstill: start over, and wait for the car to do so too"""
    armed: bool = False
    highest: CtState = CtState.NOMINAL_RACE
    """rung the ladder is not climbed beyond"""


@dataclass(frozen=True, slots=True)
class RaceControl:
    """State of the ladder; `step` returns the next one."""

    ct_state: CtState = CtState.POWER_ON
    heartbeat: int = -1
    beat_ns: int | None = None
    """when the heartbeat last changed"""

    def step(self, now_ns: int, heard: Heard, demand: Demand) -> RaceControl:
        """At most one rung a call."""
        beats = heard.heartbeat_age_s <= HEARTBEAT_TIMEOUT_S and heard.heartbeat != self.heartbeat
        seen = replace(self, heartbeat=heard.heartbeat, beat_ns=now_ns) if beats else self
        alive = seen.heartbeat_frozen_s(now_ns) < HEARTBEAT_TIMEOUT_S
        return replace(seen, ct_state=_next(self.ct_state, heard, demand, alive))

    def heartbeat_frozen_s(self, now_ns: int) -> float:
        """Seconds since race control's heartbeat last changed; infinite before the first."""
        return float("inf") if self.beat_ns is None else (now_ns - self.beat_ns) / NS_PER_S


def stronger_vehicle_flag(base: int, marelli: int) -> int:
    """The more restrictive of the two flags heard (`base_to_car_summary` has 4 bits, `marelli_report_1` 8)."""
    return max(base, marelli, key=_severity)


def stronger_track_flag(base: int, marelli: int) -> int:
    """The more restrictive of the two track flags heard."""
    rank = (TrackFlag.NONE, TrackFlag.GREEN, TrackFlag.FULL_COURSE_YELLOW, TrackFlag.CHECKERED, TrackFlag.RED)
    return max(base, marelli, key=lambda flag: rank.index(flag) if flag in rank else 0)


def _severity(flag: int) -> int:
    if flag in KILL_VEHICLE_FLAGS:
        return 3
    if flag in STOP_VEHICLE_FLAGS:
        return 2
    return int(flag == VehicleFlag.YELLOW)


def _next(ct: CtState, heard: Heard, demand: Demand, heartbeat: bool) -> CtState:  # noqa: PLR0911 (one rung a line)
    sys_state = heard.sys_state if heard.car_alive else 0
    if demand.emergency:
        return CtState.EMERGENCY
    if demand.restart:
        return CtState.INIT
    if ct is CtState.EMERGENCY:
        return ct
    if demand.stop and ct >= CtState.INIT_DRIVING:
        return CtState.COORDINATED_STOP
    if ct > CtState.ACTUATOR_TEST and heard.car_alive and sys_state <= SysState.CONNECTED:
        return CtState.INIT  # the car started over: so does the ladder
    if ct is CtState.COORDINATED_STOP:
        return _pace(heard) if demand.armed else ct
    if ct in DRIVING:
        return _pace(heard)
    if ct is CtState.INIT_DRIVING:
        return _pace(heard) if sys_state == SysState.DRIVING else ct
    return CtState(ct + 1) if ct < demand.highest and _may_climb(ct, sys_state, heard, heartbeat) else ct


def _may_climb(ct: CtState, sys_state: int, heard: Heard, heartbeat: bool) -> bool:
    """Whether the car has answered this rung."""
    if ct is CtState.RACE_READY:
        return heartbeat and sys_state in (SysState.IDLE, SysState.DRIVING) and _released(heard)
    needed = {
        CtState.POWER_ON: SysState.POWER_ON,
        CtState.INIT: SysState.CONNECTED,
        CtState.ACTUATOR_TEST: SysState.TEST_DONE,
        CtState.CRANK_READY: SysState.CRANK_READY,
        CtState.CRANKING: SysState.IDLE,
    }.get(ct)
    if needed is None or not needed <= sys_state <= SysState.DRIVING:
        return False
    return heard.mode_switch or ct is not CtState.CRANK_READY


def _released(heard: Heard) -> bool:
    """Flags under which the car may start to drive."""
    go = heard.track_flag in (TrackFlag.GREEN, TrackFlag.FULL_COURSE_YELLOW)
    return go and heard.vehicle_flag not in STOP_VEHICLE_FLAGS | KILL_VEHICLE_FLAGS


def _pace(heard: Heard) -> CtState:
    slow = heard.track_flag == TrackFlag.FULL_COURSE_YELLOW or heard.vehicle_flag == VehicleFlag.YELLOW
    return CtState.CAUTION if slow else CtState.NOMINAL_RACE
