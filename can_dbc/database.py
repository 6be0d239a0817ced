"""The messages of a car: its DBC joined with `bus.toml`, which says what a DBC cannot, into one frozen table.

Of a DBC this reads VERSION, BO_ and SG_ (no multiplexing, no floats; one byte order in a message). A 29-bit identifier
has bit 31 set, as the DBC writes it and as frames carry it. The reader is ours because importing cantools costs every
process 0.2 s; the tests check it against cantools message by message.
"""

from __future__ import annotations

import hashlib
import re
import socket
from collections import Counter as Counts
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Literal

from pydantic import Field

from can_dbc.errors import PlatformError
from can_dbc.folder import FileModel, checked, dbc_path, read_text, read_toml
from can_dbc.units import UNITS, Unit

DEADLINE_PERIODS = 5
"""Age at which a message counts as lost where `bus.toml` names none, periods."""
EXTENDED = socket.CAN_EFF_FLAG
"""set in the identifier of a 29-bit frame"""
DLC_MAX = 8
"""bytes of a classic frame"""

Range = tuple[float, float]


@dataclass(frozen=True)
class Signal:
    """One field of a frame: physical value in DBC units = scale * raw + offset."""

    name: str
    start: int
    length: int
    little_endian: bool
    signed: bool
    scale: float
    offset: float
    unit: str
    declared: Range | None
    """range the DBC declares, DBC units"""
    limits: Range | None
    """what the car can do or take (`bus.toml`), DBC units"""
    to_si: Unit
    """of `unit`"""

    @property
    def raw_range(self) -> tuple[int, int]:
        """Smallest and largest integer the field holds."""
        if self.signed:
            return -(1 << self.length - 1), (1 << self.length - 1) - 1
        return 0, (1 << self.length) - 1

    def raw(self, value: float) -> int:
        """Integer of the field nearest to a value in DBC units, held to what the field carries."""
        low, high = self.raw_range
        return min(max(round((value - self.offset) / self.scale), low), high)

    @property
    def si_name(self) -> str:
        """Name of the value in SI: without the unit some names end in, which it no longer has."""
        return self.name.removesuffix(f"_{self.unit}") if self.unit else self.name

    @property
    def si_factor(self) -> float:
        """SI value over value in DBC units."""
        return self.to_si.factor

    @property
    def si_resolution(self) -> float:
        """Size of one raw step, SI."""
        return abs(self.scale * self.si_factor)

    @property
    def first_byte(self) -> int:
        """Index of the byte that holds the start bit."""
        return self.start // 8

    def shift(self, dlc: int) -> int:
        """Bits to the right of the field when the frame is one integer of its own byte order.

        A big-endian start bit names the most significant bit, counted within its byte from the right.
        """
        if self.little_endian:
            return self.start
        from_the_left = self.start // 8 * 8 + 7 - self.start % 8
        return dlc * 8 - from_the_left - self.length


@dataclass(frozen=True)
class Counter:
    """A signal that advances by one, modulo `modulus`, with every frame of its message."""

    signal: str
    modulus: int


@dataclass(frozen=True)
class BusMessage:
    """One frame layout with its timing and direction."""

    name: str
    id: int
    """bit 31 is set where it is a 29-bit identifier"""
    dlc: int
    sender: str
    direction: Literal["car", "computer"]
    """which end of the cable sends it"""
    signals: tuple[Signal, ...]
    period_s: float
    deadline_s: float
    counter: Counter | None

    @property
    def byte_order(self) -> Literal["little", "big"]:
        """The one byte order of all its signals (checked when read)."""
        return "little" if self.signals[0].little_endian else "big"

    @property
    def id_text(self) -> str:
        """As people write it: 0x53C, 0x18FF1234."""
        return id_text(self.id)

    @cached_property
    def signal(self) -> Mapping[str, Signal]:
        """Signals by name."""
        return MappingProxyType({signal.name: signal for signal in self.signals})


def id_text(identifier: int) -> str:
    """An identifier as people write it."""
    return f"0x{identifier & ~EXTENDED:03X}"


@dataclass(frozen=True)
class Database:
    """Every message of the bus, by identifier rising."""

    version: str
    bitrate: int
    """bit/s"""
    messages: tuple[BusMessage, ...]
    sha256: str
    """hash over DBC and `bus.toml`, for recordings"""

    def find(self, name: str) -> tuple[BusMessage, Signal]:
        """A signal by its name, or by `message.signal` where several messages have one of that name.

        Raises:
            PlatformError: there is none, or more than one.
        """
        of, _, signal = name.rpartition(".")
        found = [m for m in self.messages if signal in m.signal and of in ("", m.name)]
        if len(found) == 1:
            return found[0], found[0].signal[signal]
        if found:
            places = ", ".join(f"{message.name}.{signal}" for message in found)
            raise PlatformError(f"several messages have a signal {signal}: write one of {places}")
        raise PlatformError(f"the DBC has no signal {name}{_like(signal, self.messages)}")


def _like(name: str, messages: tuple[BusMessage, ...]) -> str:
    near = get_close_matches(name, [signal.name for message in messages for signal in message.signals], n=3)
    return f"; like it are {', '.join(near)}" if near else ""


class Timing(FileModel):
    """`[default]` of `bus.toml`, s."""

    period_s: float = Field(gt=0, le=60)
    deadline_s: float = Field(gt=0, le=600)


class BusFile(FileModel):
    """`bus.toml`. Times in s, ranges in the units of the DBC."""

    dbc_version: str
    bitrate: int = Field(ge=10_000, le=1_000_000)
    computer: str = "COMPUTER"
    """node of the DBC that this computer is"""
    computer_sends: tuple[str, ...] = ()
    """messages it sends, where the DBC does not name the sender"""
    default: Timing
    period_s: dict[str, Annotated[float, Field(gt=0, le=60)]] = Field(default={})
    deadline_s: dict[str, Annotated[float, Field(gt=0, le=600)]] = Field(default={})
    counter: dict[str, tuple[str, Annotated[int, Field(ge=2)]]] = Field(default={})
    """message -> signal that advances by one every frame, and its modulus"""
    limits: dict[str, Range] = Field(default={})
    """signal, or `message.signal` -> what the car can do"""
    units: dict[str, str] = Field(default={})
    """unit as the DBC writes it -> one of `can_dbc.units`"""


_MESSAGE = re.compile(r"BO_ (?P<id>\d+) (?P<name>\w+) *: (?P<dlc>\d+) (?P<sender>\w+)")
_SIGNAL = re.compile(
    r"\s+SG_ (?P<name>\w+) : (?P<start>\d+)\|(?P<length>\d+)@(?P<order>[01])(?P<sign>[+-]) "
    r"\((?P<scale>[^,]+),(?P<offset>[^)]+)\) \[(?P<low>[^|]+)\|(?P<high>[^]]+)\] \"(?P<unit>[^\"]*)\""
)
_SIGNAL_LINE = re.compile(r"\s+SG_ ")
_VERSION = re.compile(r'VERSION "([^"]*)"')


def load_database(folder: Path) -> Database:
    """Read DBC and `bus.toml` of a car folder.

    Raises:
        PlatformError: missing, damaged or contradictory files.
    """
    path = dbc_path(folder)
    text, bus_text = read_text(path), read_text(folder / "bus.toml")
    bus = checked(BusFile, read_toml(folder / "bus.toml"), folder / "bus.toml")
    try:
        messages = tuple(sorted(_messages(text, bus), key=lambda message: message.id))
        _check_version(text, bus)
    except PlatformError as error:
        raise PlatformError(f"{path}: {error}") from None
    if not messages:
        raise PlatformError(f"{path}: holds no message (no line begins with BO_)")
    _check_unique(messages, path)
    _check_names(bus, messages, folder / "bus.toml")
    return Database(bus.dbc_version, bus.bitrate, messages, hashlib.sha256((text + bus_text).encode()).hexdigest())


def _check_version(dbc: str, bus: BusFile) -> None:
    match = _VERSION.search(dbc)
    if match is None:
        raise PlatformError("the DBC has no VERSION line")
    if match[1] != bus.dbc_version:
        raise PlatformError(f"VERSION {match[1]!r} is not dbc_version {bus.dbc_version!r} of bus.toml: which is right?")


def _check_unique(messages: tuple[BusMessage, ...], path: Path) -> None:
    for of, values in (("identifier", [m.id_text for m in messages]), ("name", [m.name for m in messages])):
        if twice := [value for value, count in Counts(values).items() if count > 1]:
            raise PlatformError(f"{path}: two messages have the {of} {twice[0]}")


def _messages(dbc: str, bus: BusFile) -> Iterator[BusMessage]:
    """Each BO_ line with the SG_ lines under it."""
    head: re.Match[str] | None = None
    signals: list[Signal] = []
    for line in [*dbc.splitlines(), ""]:
        if head is not None and _SIGNAL_LINE.match(line):
            signals.append(_signal(head["name"], line, bus))
        elif head is not None:
            yield _message(head, tuple(signals), bus)
            head, signals = None, []
        if line.startswith("BO_ "):
            head = _MESSAGE.match(line)
            if head is None:
                raise PlatformError(f"cannot read this line: {line!r}")


def _message(head: re.Match[str], signals: tuple[Signal, ...], bus: BusFile) -> BusMessage:
    name, number, dlc, sender = head["name"], int(head["id"]), int(head["dlc"]), head["sender"]
    if number & ~EXTENDED > (socket.CAN_EFF_MASK if number & EXTENDED else socket.CAN_SFF_MASK):
        remedy = "" if number & EXTENDED else "; a 29-bit one is written with bit 31 set (2147483648 added)"
        raise PlatformError(f"{name}: identifier {number} has more than {29 if number & EXTENDED else 11} bits{remedy}")
    if not 1 <= dlc <= DLC_MAX:
        raise PlatformError(f"{name}: {dlc} bytes: a classic frame has 1 to {DLC_MAX}")
    if len({signal.little_endian for signal in signals}) != 1:
        raise PlatformError(f"{name}: no signals, or two byte orders in one message")
    _refuse_misfits(name, dlc, signals)
    period = bus.period_s.get(name, bus.default.period_s)
    usual = DEADLINE_PERIODS * period if name in bus.period_s else bus.default.deadline_s
    counter = bus.counter.get(name)
    ours = sender == bus.computer or name in bus.computer_sends
    return BusMessage(
        name=name,
        id=number,
        dlc=dlc,
        sender=sender,
        direction="computer" if ours else "car",
        signals=signals,
        period_s=period,
        deadline_s=bus.deadline_s.get(name, usual),
        counter=Counter(*counter) if counter else None,
    )


def _refuse_misfits(name: str, dlc: int, signals: tuple[Signal, ...]) -> None:
    """Fields lie within the frame, apart from each other, and have a step."""
    taken = 0
    for signal in signals:
        shift = signal.shift(dlc)
        field = (1 << signal.length) - 1 << max(shift, 0)
        if shift < 0 or shift + signal.length > 8 * dlc or not signal.length:
            raise PlatformError(f"{name}: {signal.name} does not fit into its {dlc} bytes")
        if taken & field:
            raise PlatformError(f"{name}: {signal.name} overlaps another signal")
        if not signal.scale:
            raise PlatformError(f"{name}: {signal.name} has scale 0")
        taken |= field


def _signal(message: str, line: str, bus: BusFile) -> Signal:
    match = _SIGNAL.match(line)
    if match is None:
        raise PlatformError(f"cannot read this line: {line!r}; multiplexed signals are not read")
    name, unit = match["name"], match["unit"]
    known = bus.units.get(unit, unit)
    if known not in UNITS:
        raise PlatformError(
            f"{message}: {name} has the unit {unit!r}, which is not known; name one that is in [units] of bus.toml,"
            f' "{unit}" = "...": {", ".join(filter(None, UNITS))}'
        )
    try:
        low, high, scale, offset = (float(match[part]) for part in ("low", "high", "scale", "offset"))
    except ValueError:
        raise PlatformError(f"cannot read this line: {line!r}") from None
    return Signal(
        name=name,
        start=int(match["start"]),
        length=int(match["length"]),
        little_endian=match["order"] == "1",
        signed=match["sign"] == "-",
        scale=scale,
        offset=offset,
        unit=unit,
        declared=None if low == high == 0 else (low, high),
        limits=bus.limits.get(f"{message}.{name}", bus.limits.get(name)),
        to_si=UNITS[known],
    )


def _check_names(bus: BusFile, messages: tuple[BusMessage, ...], path: Path) -> None:
    """A name that `bus.toml` misspells would silently have the defaults."""
    signals = {message.name: message.signal for message in messages}
    named = {"period_s": [*bus.period_s], "deadline_s": [*bus.deadline_s], "counter": [*bus.counter]}
    for table, keys in (*named.items(), ("computer_sends", [*bus.computer_sends])):
        if unknown := [key for key in keys if key not in signals]:
            raise PlatformError(f"{path}: {table}: the DBC has no message {unknown[0]}")
    for message, (signal, modulus) in bus.counter.items():
        if signal not in signals[message]:
            raise PlatformError(f"{path}: counter.{message}: the message has no signal {signal}")
        if modulus - 1 > signals[message][signal].raw_range[1]:
            raise PlatformError(f"{path}: counter.{message}: {signal} cannot count to {modulus - 1}")
    for name, (low, high) in bus.limits.items():
        of, _, signal = name.rpartition(".")
        if not any(signal in m.signal and of in ("", m.name) for m in messages):
            raise PlatformError(f"{path}: limits: the DBC has no signal {name}{_like(signal, messages)}")
        if not low < high:
            raise PlatformError(f"{path}: limits.{name} = [{low:g}, {high:g}]: the first must be below the second")
