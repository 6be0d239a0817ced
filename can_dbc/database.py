"""The messages of the car: `av24.dbc` joined with `av24.toml` into one frozen table.

The DBC subset read here is what `av24.dbc` uses: VERSION, BO_, SG_ (no multiplexing, no floats, no extended
identifiers). The reader is ours because importing cantools costs every process 0.2 s; the tests check it
against cantools message by message.
"""

from __future__ import annotations

import hashlib
import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

from can_dbc.units import SI

DBC_PATH = Path(__file__).with_name("av24.dbc")
"""The DBC, for tools that read one themselves (candump, cantools); `av24.toml` lies beside it."""
DEADLINE_PERIODS = 5
"""Age at which a message counts as lost where the TOML names none, periods."""

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
    """what the car can do or take (av24.toml), DBC units"""

    @property
    def raw_range(self) -> tuple[int, int]:
        """Smallest and largest integer the field holds."""
        if self.signed:
            return -(1 << self.length - 1), (1 << self.length - 1) - 1
        return 0, (1 << self.length) - 1

    @property
    def si_name(self) -> str:
        """Name of the value in SI: without the unit some names end in, which it no longer has."""
        return self.name.removesuffix(f"_{self.unit}") if self.unit else self.name

    @property
    def si_factor(self) -> float:
        """SI value over value in DBC units."""
        return SI[self.unit]

    @property
    def si_resolution(self) -> float:
        """Size of one raw step, SI."""
        return abs(self.scale * self.si_factor)

    @property
    def si_limits(self) -> Range | None:
        """`limits` in SI."""
        return None if self.limits is None else (self.limits[0] * self.si_factor, self.limits[1] * self.si_factor)

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
class Message:
    """One frame layout with its timing and direction."""

    name: str
    id: int
    dlc: int
    sender: str
    signals: tuple[Signal, ...]
    period_s: float
    deadline_s: float
    counter: Counter | None

    @property
    def direction(self) -> Literal["car", "computer"]:
        """Which end of the cable sends it."""
        return "computer" if self.sender == "COMPUTER" else "car"

    @property
    def byte_order(self) -> Literal["little", "big"]:
        """The one byte order of all its signals (checked when read)."""
        return "little" if self.signals[0].little_endian else "big"

    @cached_property
    def signal(self) -> Mapping[str, Signal]:
        """Signals by name."""
        return MappingProxyType({signal.name: signal for signal in self.signals})


@dataclass(frozen=True)
class Database:
    """Every message of the bus, by identifier rising."""

    version: str
    messages: tuple[Message, ...]
    sha256: str
    """hash over both files, for recordings"""


class DatabaseError(ValueError):
    """The DBC and the TOML do not fit together, or the DBC uses what this reader does not know."""


_MESSAGE = re.compile(r"BO_ (?P<id>\d+) (?P<name>\w+) ?: (?P<dlc>\d+) (?P<sender>\w+)")
_SIGNAL = re.compile(
    r" SG_ (?P<name>\w+) : (?P<start>\d+)\|(?P<length>\d+)@(?P<order>[01])(?P<sign>[+-]) "
    r"\((?P<scale>[^,]+),(?P<offset>[^)]+)\) \[(?P<low>[^|]+)\|(?P<high>[^]]+)\] \"(?P<unit>[^\"]*)\""
)
_VERSION = re.compile(r'VERSION "([^"]*)"')


def load_database() -> Database:
    """Read the database shipped with this package.

    Raises:
        DatabaseError: missing, damaged or contradictory files.
    """
    try:
        return parse_database(DBC_PATH.read_text(), DBC_PATH.with_suffix(".toml").read_text())
    except DatabaseError as error:
        raise DatabaseError(f"{DBC_PATH}: {error}") from None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise DatabaseError(f"{DBC_PATH} with its .toml cannot be read: {error!r}") from None


def parse_database(dbc: str, toml: str) -> Database:
    """Join a DBC with its TOML.

    Raises:
        DatabaseError: a line this reader does not know, a name in the TOML the DBC lacks, versions that differ.
    """
    extra = tomllib.loads(toml)
    version = _version(dbc)
    if version != extra["dbc_version"]:
        raise DatabaseError(f"DBC version {version!r} is not {extra['dbc_version']!r} of the TOML")
    messages = tuple(sorted(_messages(dbc, extra), key=lambda message: message.id))
    if not messages or len({m.id for m in messages}) + len({m.name for m in messages}) != 2 * len(messages):
        raise DatabaseError("no messages, or two of one identifier or name")
    _refuse_unknown_names(extra, messages)
    return Database(version, messages, hashlib.sha256((dbc + toml).encode()).hexdigest())


def _version(dbc: str) -> str:
    match = _VERSION.search(dbc)
    if match is None:
        raise DatabaseError("the DBC has no VERSION line")
    return match[1]


def _messages(dbc: str, extra: dict[str, Any]) -> Iterator[Message]:
    """Each BO_ line with the SG_ lines under it."""
    head: re.Match[str] | None = None
    signals: list[Signal] = []
    for line in [*dbc.splitlines(), ""]:
        if line.startswith(" SG_"):
            signals.append(_signal(line, extra["limits"]))
        elif head is not None:
            yield _message(head, tuple(signals), extra)
            head, signals = None, []
        if line.startswith("BO_ "):
            head = _MESSAGE.match(line)
            if head is None:
                raise DatabaseError(f"cannot read this DBC line: {line!r}")


def _message(head: re.Match[str], signals: tuple[Signal, ...], extra: dict[str, Any]) -> Message:
    name = head["name"]
    if len({signal.little_endian for signal in signals}) != 1:
        raise DatabaseError(f"{name}: no signals, or two byte orders in one message")
    _refuse_misfits(name, int(head["dlc"]), signals)
    default = extra["default"]
    period = extra["period_s"].get(name, default["period_s"])
    usual = default["deadline_s"] if name not in extra["period_s"] else DEADLINE_PERIODS * period
    counter = extra["counter"].get(name)
    return Message(
        name=name,
        id=int(head["id"]),
        dlc=int(head["dlc"]),
        sender=head["sender"],
        signals=signals,
        period_s=period,
        deadline_s=extra["deadline_s"].get(name, usual),
        counter=Counter(*counter) if counter else None,
    )


def _refuse_misfits(name: str, dlc: int, signals: tuple[Signal, ...]) -> None:
    """Fields lie within the frame, apart from each other, and have a step."""
    taken = 0
    for signal in signals:
        shift = signal.shift(dlc)
        field = (1 << signal.length) - 1 << max(shift, 0)
        if shift < 0 or shift + signal.length > 8 * dlc or not signal.length:
            raise DatabaseError(f"{name}: {signal.name} does not fit into its {dlc} bytes")
        if taken & field:
            raise DatabaseError(f"{name}: {signal.name} overlaps another signal")
        if not signal.scale:
            raise DatabaseError(f"{name}: {signal.name} has scale 0")
        taken |= field


def _signal(line: str, limits: dict[str, list[float]]) -> Signal:
    match = _SIGNAL.match(line)
    if match is None or match["unit"] not in SI:
        raise DatabaseError(f"cannot read this DBC line: {line!r}")
    low, high = float(match["low"]), float(match["high"])
    limit = limits.get(match["name"])
    return Signal(
        name=match["name"],
        start=int(match["start"]),
        length=int(match["length"]),
        little_endian=match["order"] == "1",
        signed=match["sign"] == "-",
        scale=float(match["scale"]),
        offset=float(match["offset"]),
        unit=match["unit"],
        declared=None if low == high == 0 else (low, high),
        limits=None if limit is None else (limit[0], limit[1]),
    )


def _refuse_unknown_names(extra: dict[str, Any], messages: tuple[Message, ...]) -> None:
    """A name the TOML misspells would silently have the defaults."""
    signals = {message.name: {signal.name for signal in message.signals} for message in messages}
    known_signals = set().union(*signals.values())
    unknown = [key for table in ("period_s", "deadline_s", "counter") for key in extra[table] if key not in signals]
    unknown += [key for key in extra["limits"] if key not in known_signals]
    unknown += [key for key, (signal, _) in extra["counter"].items() if signal not in signals.get(key, ())]
    if unknown:
        raise DatabaseError(f"the TOML names what the DBC lacks: {', '.join(unknown)}")
