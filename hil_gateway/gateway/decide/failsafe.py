"""The failsafe: one table of cause x action x clear condition, and the pure step that applies it.

Every condition is a measure in seconds for which it has held (0: does not hold, infinite: holds); a row fires when
its measure reaches the row's threshold. What fires latches: the action only rises until the gateway is
armed again, and a request to arm is an edge that is answered in its period or dropped.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType
from typing import NamedTuple

from hil_gateway.bus.messages import FailsafeAction, OperatorAction

HOLDS = float("inf")
"""Measure of a condition that holds now, however long already."""


class Clear(StrEnum):
    """What it takes to drive again after a row has fired."""

    REARM = "the condition is gone, the car stands, a person arms again"
    DISARM = "the car stands, a person disarms, the ladder is climbed again, the condition is gone, a person arms"


class WhileSilent(StrEnum):
    """What a row does while no actuator commands are sent."""

    NOTHING = "-"
    EMERGENCY = "ct_state 12"
    BEYOND_INIT = "ct_state 12 once the ladder is beyond 2"


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the table."""

    cause: str
    meaning: str
    """for people"""
    threshold_s: float
    action: FailsafeAction
    clear: Clear
    while_silent: WhileSilent = WhileSilent.NOTHING
    remedy: str = ""
    """what a person does about it, where the meaning does not say"""
    awaits: str = ""
    """process that is missing: to start it is the remedy"""
    of: str = ""
    """its measure, where that is not named as the cause"""

    @property
    def measure(self) -> str:
        """What has to hold for the threshold."""
        return self.of or self.cause

    @property
    def explanation(self) -> str:
        """Meaning and remedy."""
        remedy = f"`hil {self.awaits} run`" if self.awaits else self.remedy
        return f"{self.meaning}: {remedy}" if remedy else self.meaning

    def fires(self, measures: Mapping[str, float]) -> bool:
        """Whether its measure has held for long enough or is missing; not-a-number fires."""
        return self.reached(measures.get(self.measure, HOLDS))

    def reached(self, held_s: float) -> bool:
        """Whether its measure has held for long enough."""
        return not held_s <= 0 and not held_s < self.threshold_s


COMMAND_AGE = "command_age"
"""measure of the planner, the last in the chain: it is silent where any before it is"""
_STOP, _EMERGENCY = FailsafeAction.CONTROLLED_STOP, FailsafeAction.EMERGENCY_STOP

TABLE: tuple[Row, ...] = (
    Row("operator_emergency", "an emergency was asked for", 0.0, _EMERGENCY, Clear.DISARM, WhileSilent.EMERGENCY),
    Row(
        "vehicle_flag_kill",
        "purple flag or e-kill from race control",
        0.0,
        _EMERGENCY,
        Clear.DISARM,
        WhileSilent.EMERGENCY,
    ),
    Row(
        "foreign_emergency",
        "another computer reports an emergency",
        0.0,
        _EMERGENCY,
        Clear.DISARM,
        WhileSilent.EMERGENCY,
    ),
    Row(
        "uncommanded_motion",
        "the car drives although no commands are sent: it obeys old ones",
        0.0,
        _EMERGENCY,
        Clear.DISARM,
        WhileSilent.EMERGENCY,
    ),
    Row("car_emergency", "the car reports an emergency", 0.0, _EMERGENCY, Clear.DISARM, WhileSilent.BEYOND_INIT),
    Row("gateway_late", "the gateway missed its period", 0.1, _EMERGENCY, Clear.DISARM, of="gateway_gap"),
    Row("command_dead", "no planner sends commands", 0.5, _EMERGENCY, Clear.REARM, of=COMMAND_AGE, awaits="planner"),
    Row("can_silent", "the car sends nothing", 0.1, _EMERGENCY, Clear.DISARM, of="can_silence"),
    Row("steering_stuck", "the steering does not follow its command", 0.1, _EMERGENCY, Clear.DISARM),
    Row("pedals_stuck", "brakes or accelerator do not follow their command", 0.1, _EMERGENCY, Clear.DISARM),
    Row(
        "commands_unanswered",
        "the car does not brake, or drives on, against its commands",
        0.15,
        _EMERGENCY,
        Clear.DISARM,
    ),
    Row("operator_stop", "a stop was asked for", 0.0, _STOP, Clear.REARM),
    Row(
        "gateway_ending", "the gateway was asked to end while the car moves", 0.0, _STOP, Clear.REARM, awaits="gateway"
    ),
    Row("command_stale", "no fresh planner command", 0.1, _STOP, Clear.REARM, of=COMMAND_AGE, awaits="planner"),
    Row("state_invalid", "a report needed for driving is missing or implausible", 0.05, _STOP, Clear.REARM),
    Row("estimate_invalid", "no valid estimate", 0.05, _STOP, Clear.REARM, awaits="estimator"),
    Row(
        "heading_unknown", "where the car points is not known", 0.0, _STOP, Clear.REARM, remedy="push it forward by 3 m"
    ),
    Row("counters_wrong", "rolling counters jump", 0.0, _STOP, Clear.REARM),
    Row("foreign_commands", "another computer commands the actuators", 0.0, _STOP, Clear.REARM),
    Row("heartbeat_frozen", "race control's heartbeat stands still", 0.5, _STOP, Clear.REARM),
    Row("track_flag_stop", "red or checkered flag from race control", 0.0, _STOP, Clear.REARM),
    Row("vehicle_flag_stop", "black or stop flag from race control", 0.0, _STOP, Clear.REARM),
    Row("car_not_driving", "the car does not say that it is driving", 0.0, _STOP, Clear.REARM),
    Row("engine_running", "the engine runs, and gateway.mode is actuator_test", 0.0, _STOP, Clear.REARM),
    Row("car_failure", "the car reports a failure of its own", 0.0, _STOP, Clear.REARM),
    Row("mode_switch_off", "the mode switch at the car is off", 0.0, _STOP, Clear.REARM),
    Row("safety_switch", "a safety switch at the car is set", 0.0, _STOP, Clear.REARM),
    Row("supply_low", "the battery is nearly empty: is it charged?", 1.0, _STOP, Clear.REARM),
    Row("engine_stalled", "the engine has stopped", 0.3, _STOP, Clear.REARM),
    Row("tyre_flat", "a tyre has lost half of its pressure", 0.3, _STOP, Clear.REARM),
    Row("sender_doubled", "a report comes from two senders", 0.0, _STOP, Clear.REARM),
    Row("position_wrong", "position fixes do not fit the way the car has gone", 0.0, _STOP, Clear.REARM),
    Row("wheel_speed_wrong", "wheel speeds do not fit each other, or neither fixes nor IMU", 0.15, _STOP, Clear.REARM),
    Row("yaw_rate_wrong", "the yaw rate does not fit wheels, steering and force", 0.15, _STOP, Clear.REARM),
    Row("acceleration_wrong", "the IMU does not fit wheel speeds and yaw rate", 0.2, _STOP, Clear.REARM),
    Row("position_lost", "no position fixes", 1.0, _STOP, Clear.REARM),
    Row("off_road", "the car is not on the track", 0.05, _STOP, Clear.REARM),
    Row("wrong_way", "the car points across the track or against it", 0.2, _STOP, Clear.REARM),
)
"""In order of priority: the first row that fires with the strongest action names the cause."""

MEASURES = frozenset(row.measure for row in TABLE)
ROWS = {row.cause: row for row in TABLE}
_MEASURES = tuple(row.measure for row in TABLE)
_SEVERITY = {action: rank for rank, action in enumerate(FailsafeAction)}


class Inputs(NamedTuple):
    """What the failsafe sees in one period."""

    measures: Mapping[str, float]
    """measure -> seconds it has held; what is missing counts as holding"""
    standing: bool
    request: OperatorAction | None = None
    """a person's request that arrived in this very period"""
    may_arm: bool = True
    """the mode allows commands"""
    unready: Mapping[str, str] = MappingProxyType({})
    """what else stands in the way of arming, and what to do about it, in words"""


IN_EMERGENCY = "in_emergency"
"""what keeps a car from being cranked and armed until a person disarms"""


class Failsafe(NamedTuple):
    """Latched state; `step` returns the next one."""

    action: FailsafeAction = FailsafeAction.SILENT
    cause: str = ""

    @property
    def armed(self) -> bool:
        """Whether actuator commands are sent at all."""
        return self.action is not FailsafeAction.SILENT

    @property
    def engine_off(self) -> bool:
        """Whether the car, too, is to go into its emergency, which cuts the engine. Not where only the planner is gone:
        that is no fault of the car, and the stop has commands of its own."""
        rearms = self.cause in ROWS and ROWS[self.cause].clear is Clear.REARM
        return self.action is FailsafeAction.EMERGENCY_STOP and not rearms

    @property
    def _rank(self) -> tuple[int, bool]:
        return _SEVERITY[self.action], self.engine_off

    def step(self, inputs: Inputs) -> Failsafe:
        """Next state; never raises, whatever the inputs."""
        row = first_firing(inputs)
        if self.action is FailsafeAction.SILENT:
            wants = inputs.request is OperatorAction.ARM
            return Failsafe(FailsafeAction.DRIVE) if wants and not self.missing(inputs) else Failsafe()
        if inputs.request is OperatorAction.DISARM and inputs.standing:
            return Failsafe()
        if row is not None and _rank(row) > self._rank:
            return Failsafe(row.action, row.cause)
        if self.action is FailsafeAction.DRIVE and inputs.request is OperatorAction.DISARM:
            return Failsafe(FailsafeAction.CONTROLLED_STOP, "disarmed_moving")
        if inputs.request is OperatorAction.ARM and not self.missing(inputs):
            return Failsafe(FailsafeAction.DRIVE)
        return Failsafe(self.action, self.cause)

    def missing(self, inputs: Inputs) -> tuple[str, ...]:
        """Why a request to arm would be refused now; nothing while it drives."""
        if self.action is FailsafeAction.DRIVE:
            return ()
        return ((IN_EMERGENCY,) if self.engine_off else ()) + missing_for_arming(inputs)


def first_firing(inputs: Inputs) -> Row | None:
    """The strongest row whose measure has reached its threshold."""
    return max(_firing(inputs), key=_rank, default=None)


def _rank(row: Row) -> tuple[int, bool]:
    return _SEVERITY[row.action], row.clear is Clear.DISARM


def first_firing_while_silent(inputs: Inputs) -> Row | None:
    """The first row that fires and acts on the ladder even while no commands are sent."""
    return next((row for row in _firing(inputs) if row.while_silent is not WhileSilent.NOTHING), None)


def missing_for_arming(inputs: Inputs) -> tuple[str, ...]:
    """Why a request to arm would be refused now: every firing row, who waits for others last, movement, mode, what does
    not fit."""
    firing = tuple(row.cause for row in sorted(_firing(inputs), key=lambda row: row.measure == COMMAND_AGE))
    standing = () if inputs.standing else ("car_moving",)
    return firing + standing + (() if inputs.may_arm else ("mode",)) + tuple(inputs.unready)


def _firing(inputs: Inputs) -> list[Row]:
    """In order of the table; nearly always none, and a row whose measure is 0 cannot fire."""
    held = zip(TABLE, map(inputs.measures.get, _MEASURES), strict=True)
    return [row for row, held_s in held if held_s != 0.0 and row.reached(HOLDS if held_s is None else held_s)]


def table_markdown() -> str:
    """The table for the documentation: rows in order of priority, under what they do and what ends it."""
    ends = dict.fromkeys((row.action, row.clear) for row in TABLE)
    return "\n\n".join(_part_markdown(action, clear) for action, clear in ends)


def _part_markdown(action: FailsafeAction, clear: Clear) -> str:
    rows = [row for row in TABLE if (row.action, row.clear) == (action, clear)]
    lines = [
        f"`{action.value}`; the car drives again when {clear.value}:",
        "",
        "| cause | meaning | held for |",
        "|" + " --- |" * 3,
    ]
    lines += [f"| {row.cause} | {row.explanation} | {_held_for(row)} |" for row in rows]
    lines += _while_silent(rows)
    return "\n".join(lines)


def _held_for(row: Row) -> str:
    """Threshold, with the measure where it has a name of its own."""
    threshold = f"{row.threshold_s * 1000:.0f} ms" if row.threshold_s else ""
    return threshold if row.measure == row.cause else f"{threshold} ({row.measure})"


def _while_silent(rows: list[Row]) -> list[str]:
    """What rows do although nothing is commanded."""
    said = {row.while_silent: "" for row in rows if row.while_silent is not WhileSilent.NOTHING}
    for what in said:
        said[what] = ", ".join(f"`{row.cause}`" for row in rows if row.while_silent is what)
    return (
        ["\nWhile silent: " + "; ".join(f"{what.value} for {causes}" for what, causes in said.items()) + "."]
        if said
        else []
    )
