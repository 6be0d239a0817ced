"""States and flags as they stand on the wire: computer, car, race control (docs/failsafe.md)."""

from __future__ import annotations

from enum import IntEnum


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


def stronger_vehicle_flag(base: int, marelli: int) -> int:
    """The more restrictive of the two flags received (`base_to_car_summary` has 4 bits, `marelli_report_1` 8)."""
    return max(base, marelli, key=_severity)


def stronger_track_flag(base: int, marelli: int) -> int:
    """The more restrictive of the two track flags received."""
    rank = (TrackFlag.NONE, TrackFlag.GREEN, TrackFlag.FULL_COURSE_YELLOW, TrackFlag.CHECKERED, TrackFlag.RED)
    return max(base, marelli, key=lambda flag: rank.index(flag) if flag in rank else 0)


def _severity(flag: int) -> int:
    if flag in KILL_VEHICLE_FLAGS:
        return 3
    if flag in STOP_VEHICLE_FLAGS:
        return 2
    return int(flag == VehicleFlag.YELLOW)
