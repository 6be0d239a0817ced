"""States and flags by their meaning: computer, car, race control (docs/failsafe.md); codes are those of the AV-24."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from typing import TypeVar


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
    """What the car reports; the ladder rises up to DRIVING."""

    UNKNOWN = 0
    POWER_ON = 1
    CONNECTED = 2
    TESTING = 3
    TEST_DONE = 4
    CRANK_READY = 5
    PRE_CRANK = 6
    CRANKING = 7
    IDLE = 8
    DRIVING = 9
    SHUT_ENGINE = 10
    EMERGENCY = 16
    CRITICAL_LIMIT = 18


STEERS = (SysState.DRIVING, SysState.EMERGENCY)
"""in which the car follows steering commands"""


class TrackFlag(IntEnum):
    """Flag shown to everybody."""

    UNKNOWN = -1
    NONE = 0
    GREEN = 1
    RED = 3
    CHECKERED = 4
    FULL_COURSE_YELLOW = 9


class VehicleFlag(IntEnum):
    """Flag shown to this car."""

    UNKNOWN = -1
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


def under_yellow(track_flag: int, vehicle_flag: int) -> bool:
    """Whether race control asks to drive slowly."""
    return track_flag == TrackFlag.FULL_COURSE_YELLOW or vehicle_flag == VehicleFlag.YELLOW


E = TypeVar("E", bound=IntEnum)


def meanings(codes: Mapping[str, int], states: type[E]) -> dict[int, E]:
    """Code on the wire -> what it means."""
    return {code: states[name.upper()] for name, code in codes.items()}


STANDS_IN = {
    CtState.POWER_ON: "init", CtState.INIT_DRIVING: "nominal_race", CtState.CAUTION: "nominal_race",
    CtState.COORDINATED_STOP: "nominal_race",
}  # fmt: skip
"""states that a car's ladder may lack, and what is said instead; of other rungs the one below"""


def computer_codes(codes: Mapping[str, int]) -> dict[CtState, int]:
    """Code of every state of the computer, in the order of the ladder."""
    found: dict[CtState, int] = {}
    for state in CtState:
        below = found.get(CtState(max(state - 1, 1)), 0)
        found[state] = codes.get(state.name.lower(), codes.get(STANDS_IN.get(state, ""), below))
    return found


def stronger_vehicle_flag(one: int, other: int) -> int:
    """The more restrictive of the flags of two transmitters."""
    return one if one == other else max(one, other, key=_severity)


def stronger_track_flag(one: int, other: int) -> int:
    """The more restrictive of the track flags of two transmitters."""
    return one if one == other else max(one, other, key=lambda flag: _RANKS.get(flag, 0))


_RANKS: Mapping[int, int] = {
    TrackFlag.GREEN: 1, TrackFlag.FULL_COURSE_YELLOW: 2, TrackFlag.CHECKERED: 3, TrackFlag.RED: 4,
}  # fmt: skip


def _severity(flag: int) -> int:
    if flag in KILL_VEHICLE_FLAGS:
        return 3
    if flag in STOP_VEHICLE_FLAGS:
        return 2
    return int(flag == VehicleFlag.YELLOW)
