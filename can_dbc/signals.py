"""`signals.toml`: which signal of the DBC carries which quantity, and which code means which state or flag."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from types import MappingProxyType
from typing import Annotated

from pydantic import BeforeValidator, Field

from can_dbc.database import BusMessage, Database, Range, Signal
from can_dbc.errors import PlatformError
from can_dbc.folder import FileModel, checked, read_toml
from can_dbc.quantities import (
    CODES,
    COMMANDS,
    FAILURE,
    IMU,
    RECEIVER,
    REPORTS,
    TEMPERATURE,
    TYRE,
    WHEELS,
    ReportedQuantity,
)
from can_dbc.units import UNITS

SENSOR = r"^[a-z][a-z0-9_]{0,31}$"
"""names of sensors"""


class Entry(FileModel):
    """One row: quantity = factor * (value of the signal in SI) + offset."""

    signal: str
    factor: float = 1.0
    offset: float = 0.0
    unit: str | None = None
    """in place of the DBC's"""


def _as_entry(value: object) -> object:
    return {"signal": value} if isinstance(value, str) else value


Row = Annotated[Entry, BeforeValidator(_as_entry)]
Rows = dict[str, Row]
Sensors = dict[Annotated[str, Field(pattern=SENSOR)], Rows]


class TyreRows(FileModel):
    """Signals of one tyre."""

    pressure: Row | None = None
    gauge: Row | None = None
    temperature: tuple[Row, ...] = ()


class SignalsFile(FileModel):
    """`signals.toml`."""

    failures: tuple[str, ...] = ()
    report: Rows
    imu: Sensors
    receiver: Sensors
    tyre: dict[str, TyreRows] = Field(default={})
    command: Rows
    constants: dict[str, float] = Field(default={})
    resting: dict[str, float] = Field(default={})
    codes: dict[str, dict[str, Annotated[int, Field(ge=0, lt=1 << 31)]]]


@dataclass(frozen=True)
class Place:
    """Where a quantity is: value = factor * (DBC units) + offset, SI."""

    message: BusMessage
    signal: Signal
    factor: float
    offset: float

    @property
    def scale(self) -> float:
        """Quantity per raw step; negative where the signal counts the other way."""
        return self.factor * self.signal.scale

    @property
    def zero(self) -> float:
        """Quantity at raw 0."""
        return self.factor * self.signal.offset + self.offset

    @property
    def limits(self) -> Range | None:
        """What the car can do, as a quantity."""
        if self.signal.limits is None:
            return None
        low, high = sorted(self.factor * limit + self.offset for limit in self.signal.limits)
        return low, high

    def raw(self, value: float) -> int:
        """Integer of the field nearest to a value, held to what the field carries."""
        return self.signal.raw((value - self.offset) / self.factor)


@dataclass(frozen=True)
class SignalMap:
    """Everything `signals.toml` says, checked against the DBC."""

    reports: Mapping[str, Place]
    commands: Mapping[str, Place]
    sources: Mapping[str, tuple[str, ...]]
    """group of reports -> the messages behind it"""
    imus: tuple[str, ...]
    receivers: tuple[str, ...]
    failures: tuple[str, ...]
    """quantities that are 0 in a sound car"""
    constants: Mapping[str, float]
    resting: Mapping[str, float]
    codes: Mapping[str, Mapping[str, int]]
    """coded quantity -> meaning -> code on the wire"""

    @property
    def actuator_messages(self) -> tuple[str, ...]:
        """Messages that command actuators, in the order of `COMMANDS`."""
        return self._carrying(actuator=True)

    @property
    def status_messages(self) -> tuple[str, ...]:
        """Messages that say what the computer does."""
        return self._carrying(actuator=False)

    def _carrying(self, actuator: bool) -> tuple[str, ...]:
        names = (name for name, command in COMMANDS.items() if command.actuator is actuator and name in self.commands)
        return tuple(dict.fromkeys(self.commands[name].message.name for name in names))


def read_signals(folder: Path, database: Database) -> SignalMap:
    """Read `signals.toml` of a car folder.

    Raises:
        PlatformError: an unknown quantity or signal, one that is missing, units that do not fit, wrong codes.
    """
    path = folder / "signals.toml"
    file = checked(SignalsFile, read_toml(path), path)
    try:
        return _joined(file, database)
    except PlatformError as error:
        raise PlatformError(f"{path}: {error}") from None


def _joined(file: SignalsFile, database: Database) -> SignalMap:
    _check_quantities(file)
    reports = {name: _place(key, entry, unit, database) for name, key, entry, unit in _report_rows(file)}
    commands = {
        name: _place(f"command.{name}", entry, COMMANDS[name].unit, database) for name, entry in file.command.items()
    }
    failures = tuple(name for name in reports if name.startswith("failure."))
    _check_directions(reports, "report", "car")
    _check_directions(commands, "command", "computer")
    _check_apart(commands)
    for table, values in (("constants", file.constants), ("resting", file.resting)):
        for name in values:
            _find(f"{table}.{name}", name, database)
    return SignalMap(
        reports=MappingProxyType(reports),
        commands=MappingProxyType(commands),
        sources=MappingProxyType(_sources(reports)),
        imus=tuple(file.imu),
        receivers=tuple(file.receiver),
        failures=failures,
        constants=MappingProxyType(file.constants),
        resting=MappingProxyType(file.resting),
        codes=MappingProxyType(_codes(file, commands, reports)),
    )


def _report_rows(file: SignalsFile) -> Iterator[tuple[str, str, Entry, str]]:
    """Quantity, key in the file, row, unit."""
    for name, entry in file.report.items():
        yield name, f"report.{name}", entry, REPORTS[name].unit
    for kind, sensors, known in (("imu", file.imu, IMU), ("receiver", file.receiver, RECEIVER)):
        for sensor, rows in sensors.items():
            for name, entry in rows.items():
                yield f"{kind}.{sensor}.{name}", f"{kind}.{sensor}.{name}", entry, known[name].unit
    for wheel, tyre in file.tyre.items():
        for name in TYRE:
            if (row := getattr(tyre, name)) is not None:
                yield f"tyre.{wheel}.{name}", f"tyre.{wheel}.{name}", row, TYRE[name].unit
        for index, row in enumerate(tyre.temperature):
            name = f"tyre.{wheel}.temperature.{index}"
            yield name, f"tyre.{wheel}.temperature[{index}]", row, TEMPERATURE.unit
    for signal in file.failures:
        yield f"failure.{signal}", f"failures: {signal}", Entry(signal=signal), FAILURE.unit


def _check_quantities(file: SignalsFile) -> None:
    """Names that the project knows, and all that it needs."""
    _check_names("report", file.report, REPORTS)
    _check_names("command", file.command, COMMANDS)
    for kind, sensors, known in (("imu", file.imu, IMU), ("receiver", file.receiver, RECEIVER)):
        if not sensors:
            raise PlatformError(f"[{kind}.NAME] is missing: one at least is needed")
        for sensor, rows in sensors.items():
            _check_names(f"{kind}.{sensor}", rows, known)
    if unknown := sorted(set(file.tyre) - set(WHEELS)):
        raise PlatformError(f"unknown table tyre.{unknown[0]}; known are {', '.join(WHEELS)}")
    pair = {"steering_motor_primary", "steering_motor_secondary"}
    if len(pair & set(file.report)) == 1:
        raise PlatformError("report: steering_motor_primary and steering_motor_secondary go together, or neither")


def _check_names(table: str, rows: Rows, known: Mapping[str, ReportedQuantity] | Mapping[str, object]) -> None:
    if unknown := sorted(set(rows) - set(known)):
        near = get_close_matches(unknown[0], known, n=3)
        like = f"; like it are {', '.join(near)}" if near else ""
        raise PlatformError(f"unknown quantity {table}.{unknown[0]}{like}")
    required = [name for name, declared in known.items() if getattr(declared, "required", False)]
    if missing := [name for name in required if name not in rows]:
        raise PlatformError(f"{table}.{missing[0]} is missing: name the signal that carries it")


def _find(key: str, name: str, database: Database) -> tuple[BusMessage, Signal]:
    try:
        return database.find(name)
    except PlatformError as error:
        raise PlatformError(f"{key}: {error}") from None


def _place(key: str, entry: Entry, unit: str, database: Database) -> Place:
    message, signal = _find(key, entry.signal, database)
    if entry.unit is not None and entry.unit not in UNITS:
        raise PlatformError(f"{key}: unknown unit {entry.unit!r}; known are {', '.join(filter(None, UNITS))}")
    given = signal.to_si if entry.unit is None else UNITS[entry.unit]
    if given.si != unit:
        raise PlatformError(
            f"{key}: {signal.name} is in {signal.unit or 'no unit'} ({given.si}), {unit} is needed;"
            " name another signal, or its true unit: { signal = ..., unit = ... }"
        )
    if not math.isfinite(entry.factor) or entry.factor == 0.0:
        raise PlatformError(f"{key}: factor = {entry.factor:g} must not be 0")
    return Place(message, signal, entry.factor * given.factor, entry.offset)


def _check_directions(places: Mapping[str, Place], table: str, sender: str) -> None:
    for name, place in places.items():
        if place.message.direction != sender:
            message = place.message
            raise PlatformError(
                f"{table}.{name}: {message.name} is sent by the {message.direction} (node {message.sender});"
                " say otherwise with computer or computer_sends in bus.toml"
            )


def _check_apart(commands: Mapping[str, Place]) -> None:
    """Actuators are commanded only while the car is driven, the state of the computer is always sent."""
    actuators = {place.message.name for name, place in commands.items() if COMMANDS[name].actuator}
    for name, place in commands.items():
        if not COMMANDS[name].actuator and place.message.name in actuators:
            raise PlatformError(
                f"command.{name}: {place.message.name} commands actuators, too, and is not sent before the car is"
                " armed; states and acknowledgements need a message of their own"
            )
    signals = [place.signal for place in commands.values()]
    if twice := [signal.name for index, signal in enumerate(signals) if signal in signals[:index]]:
        raise PlatformError(f"command: {twice[0]} is named twice")


def _sources(reports: Mapping[str, Place]) -> dict[str, tuple[str, ...]]:
    """Groups of reports, every sensor one of its own: `imu.NAME`, `receiver.NAME`, `diagnostics`."""
    found: dict[str, dict[str, None]] = {}
    for name, place in reports.items():
        kind, _, rest = name.partition(".")
        source = REPORTS[name].source if name in REPORTS else "diagnostics" if kind == "failure" else ""
        if kind in ("imu", "receiver"):
            source = f"{kind}.{rest.partition('.')[0]}"
        if source:
            found.setdefault(source, {})[place.message.name] = None
    return {source: tuple(messages) for source, messages in found.items()}


def _codes(
    file: SignalsFile, commands: Mapping[str, Place], reports: Mapping[str, Place]
) -> dict[str, Mapping[str, int]]:
    codes: dict[str, Mapping[str, int]] = {}
    for kind, (meanings, required) in CODES.items():
        given = file.codes.get(kind, {})
        if unknown := sorted(set(given) - set(meanings)):
            raise PlatformError(f"unknown key codes.{kind}.{unknown[0]}; known are {', '.join(meanings)}")
        if missing := [meaning for meaning in meanings if meaning in required and meaning not in given]:
            raise PlatformError(f"codes.{kind}.{missing[0]} is missing")
        places = [places[name] for places in (commands, reports) for name in (kind, f"second_{kind}") if name in places]
        for meaning, code in given.items():
            if not any(place.scale * place.raw(code) + place.zero == code for place in places):
                raise PlatformError(f"codes.{kind}.{meaning} = {code}: {places[0].signal.name} cannot carry it")
        codes[kind] = MappingProxyType({meaning: given[meaning] for meaning in meanings if meaning in given})
    if unknown := sorted(set(file.codes) - set(CODES)):
        raise PlatformError(f"unknown table codes.{unknown[0]}; known are {', '.join(CODES)}")
    _check_codes(codes)
    return codes


UNIQUE_STATES = ("nominal_race", "coordinated_stop", "controlled_shutdown", "emergency")
"""of the computer: each tells the car something else to do"""


def _check_codes(codes: Mapping[str, Mapping[str, int]]) -> None:
    """Codes that are read have one meaning; several rungs of the computer's ladder may share one."""
    for kind, meanings in codes.items():
        values = list(meanings.values())
        shared = [m for m, code in meanings.items() if values.count(code) > 1]
        if kind == "ct_state":
            shared = [m for m in shared if m in UNIQUE_STATES and not _only_rungs(m, meanings)]
        if shared:
            raise PlatformError(f"codes.{kind}: {shared[0]} shares its code {meanings[shared[0]]} with another")


def _only_rungs(meaning: str, meanings: Mapping[str, int]) -> bool:
    """Whether the states that share the code of nominal racing are those of driving."""
    alike = {other for other, code in meanings.items() if code == meanings[meaning]}
    return meaning == "nominal_race" and alike <= {"init_driving", "caution", "nominal_race"}
