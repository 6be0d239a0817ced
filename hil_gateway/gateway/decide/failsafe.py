"""The failsafe: one table of cause x action x clear condition, and the pure step that applies it.

Every condition is a measure in seconds for which it has held (0: does not hold, infinite: holds); a row fires when
its measure reaches the row's threshold. What fires latches: the action only rises until the gateway is
armed again, and a request to arm is an edge that is answered at once or forgotten.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from hil_gateway.bus.messages import FailsafeAction, OperatorAction

HOLDS = float("inf")
"""Measure of a condition that holds now, however long already."""


class Clear(StrEnum):
    """What it takes to drive again after a row has fired."""

    REARM = "the condition is gone, the car stands, a person arms again"
    DISARM = "the car stands, a person disarms, the ladder is climbed again, the condition is gone, a person arms"


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the table."""

    cause: str
    measure: str
    threshold_s: float
    action: FailsafeAction
    clear: Clear


_STOP, _EMERGENCY = FailsafeAction.CONTROLLED_STOP, FailsafeAction.EMERGENCY_STOP

TABLE: tuple[Row, ...] = (
    Row("operator_emergency", "operator_emergency", 0.0, _EMERGENCY, Clear.DISARM),
    Row("vehicle_flag_kill", "vehicle_flag_kill", 0.0, _EMERGENCY, Clear.DISARM),
    Row("car_emergency", "car_emergency", 0.0, _EMERGENCY, Clear.DISARM),
    Row("foreign_emergency", "foreign_emergency", 0.0, _EMERGENCY, Clear.DISARM),
    Row("gateway_late", "gateway_gap", 0.1, _EMERGENCY, Clear.DISARM),
    Row("command_dead", "command_age", 0.5, _EMERGENCY, Clear.DISARM),
    Row("can_silent", "can_silence", 0.1, _EMERGENCY, Clear.DISARM),
    Row("operator_stop", "operator_stop", 0.0, _STOP, Clear.REARM),
    Row("command_stale", "command_age", 0.1, _STOP, Clear.REARM),
    Row("state_invalid", "state_invalid", 0.05, _STOP, Clear.REARM),
    Row("estimate_invalid", "estimate_invalid", 0.05, _STOP, Clear.REARM),
    Row("counters_wrong", "counters_wrong", 0.0, _STOP, Clear.REARM),
    Row("foreign_commands", "foreign_commands", 0.0, _STOP, Clear.REARM),
    Row("heartbeat_frozen", "heartbeat_frozen", 0.5, _STOP, Clear.REARM),
    Row("track_flag_stop", "track_flag_stop", 0.0, _STOP, Clear.REARM),
    Row("vehicle_flag_stop", "vehicle_flag_stop", 0.0, _STOP, Clear.REARM),
    Row("car_not_driving", "car_not_driving", 0.0, _STOP, Clear.REARM),
    Row("engine_running", "engine_running", 0.0, _STOP, Clear.REARM),
    Row("car_failure", "car_failure", 0.0, _STOP, Clear.REARM),
)
"""In order of priority: the first row that fires with the strongest action names the cause."""

MEASURES = frozenset(row.measure for row in TABLE)
_SEVERITY = {action: rank for rank, action in enumerate(FailsafeAction)}


@dataclass(frozen=True, slots=True)
class Inputs:
    """What the failsafe sees in one period."""

    measures: Mapping[str, float]
    """measure -> seconds it has held; what is missing counts as holding"""
    standing: bool
    request: OperatorAction | None = None
    """a person's request that arrived in this very period"""
    may_arm: bool = True
    """the mode allows commands"""


@dataclass(frozen=True, slots=True)
class Failsafe:
    """Latched state; `step` returns the next one."""

    action: FailsafeAction = FailsafeAction.SILENT
    cause: str = ""

    @property
    def armed(self) -> bool:
        """Whether actuator commands are sent at all."""
        return self.action is not FailsafeAction.SILENT

    def step(self, inputs: Inputs) -> Failsafe:
        """Next state; never raises, whatever the inputs."""
        row = first_firing(inputs)
        if self.action is FailsafeAction.SILENT:
            wants = inputs.request is OperatorAction.ARM
            return Failsafe(FailsafeAction.DRIVE) if wants and not missing_for_arming(inputs) else Failsafe()
        if inputs.request is OperatorAction.DISARM and inputs.standing:
            return Failsafe()
        if row is not None and _SEVERITY[row.action] > _SEVERITY[self.action]:
            return Failsafe(row.action, row.cause)
        if self.action is FailsafeAction.DRIVE and inputs.request is OperatorAction.DISARM:
            return Failsafe(FailsafeAction.CONTROLLED_STOP, "disarmed_moving")
        rearms = inputs.request is OperatorAction.ARM and self.action is FailsafeAction.CONTROLLED_STOP
        if rearms and not missing_for_arming(inputs):
            return Failsafe(FailsafeAction.DRIVE)
        return Failsafe(self.action, self.cause)


def first_firing(inputs: Inputs) -> Row | None:
    """The strongest row whose measure has reached its threshold."""
    firing = [row for row in TABLE if _fires(row, inputs)]
    return max(firing, key=lambda row: _SEVERITY[row.action], default=None)


def missing_for_arming(inputs: Inputs) -> tuple[str, ...]:
    """Why a request to arm would be refused now: every firing row, movement, mode."""
    firing = tuple(row.cause for row in TABLE if _fires(row, inputs))
    standing = () if inputs.standing else ("car_moving",)
    return firing + standing + (() if inputs.may_arm else ("mode",))


def _fires(row: Row, inputs: Inputs) -> bool:
    held = inputs.measures.get(row.measure, HOLDS)
    return not held <= 0 and not held < row.threshold_s  # not-a-number fires


def table_markdown() -> str:
    """The table for the documentation."""
    lines = ["| cause | condition, held for | action | drives again when |", "| --- | --- | --- | --- |"]
    lines += [
        f"| {row.cause} | {row.measure}, {row.threshold_s * 1000:.0f} ms | {row.action.value} | {row.clear.value} |"
        for row in TABLE
    ]
    return "\n".join(lines)
