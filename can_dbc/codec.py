"""Frames to values and back, by straight-line functions compiled once at load.

For every message the source of a decoder and of an encoder is written out and compiled: no loop and no table
look-up is left for run time. `decode_quantities` and `encode_quantities` speak the quantities of `signals.toml`,
`decode` and `encode` all signals in SI, `decode_raw` and `encode_raw` the units of the DBC. What arrives wrong
from the wire is a `Fault` value, never an exception; a name that does not exist or a value that is not a number
comes from our own code and raises.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import cache, cached_property, partial
from struct import Struct
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

from can_dbc.database import BusMessage, Database, Signal, id_text, load_database
from can_dbc.folder import DEFAULT_PLATFORM, platform_folder
from can_dbc.signals import Place, SignalMap, read_signals

Values = dict[str, float]
COUNTER = "counter"
"""name of the rolling counter among the quantities of a message that has one"""


class FaultKind(StrEnum):
    """Why a frame cannot be decoded."""

    UNKNOWN_ID = "unknown_id"
    WRONG_LENGTH = "wrong_length"


@dataclass(frozen=True, slots=True)
class Fault:
    """A frame that says nothing, and why."""

    kind: FaultKind
    frame_id: int
    length: int
    expected_length: int | None = None

    def __str__(self) -> str:
        name = id_text(self.frame_id)
        if self.kind is FaultKind.UNKNOWN_ID:
            return f"{name}: identifier not in the DBC"
        return f"{name}: {self.length} bytes, the DBC says {self.expected_length}"


class Field(NamedTuple):
    """What one function makes of a signal: value = scale * raw + offset, under the name `key`."""

    signal: Signal
    key: str
    scale: float
    offset: float


Fields = Callable[[BusMessage], list[Field]]
"""fields of a message, in the order of its values"""
Decoder = Callable[[bytes], Values | Fault]
Encoder = Callable[[Mapping[str, float]], tuple[int, bytes]]
Packer = Callable[[Mapping[str, int]], tuple[int, bytes]]


class Codec:
    """Codecs of one car; each kind of function is compiled when it is first asked for."""

    def __init__(self, database: Database, signals: SignalMap) -> None:
        self.version = database.version
        self.sha256 = database.sha256
        self.bitrate = database.bitrate
        self.signals = signals
        self.messages: Mapping[str, BusMessage] = MappingProxyType({m.name: m for m in database.messages})
        self.by_id: Mapping[int, BusMessage] = MappingProxyType({m.id: m for m in database.messages})
        self._quantities = _quantities_of(signals)

    def sent_by(self, sender: Literal["car", "computer"]) -> frozenset[int]:
        """Identifiers of what the car, or the computer, sends."""
        return frozenset(message.id for message in self.messages.values() if message.direction == sender)

    @cached_property
    def _decoders(self) -> dict[int, Decoder]:
        return _compile_decoders(self.messages.values(), si_fields)

    @cached_property
    def _encoders(self) -> dict[str, Encoder]:
        return _compile_encoders(self.messages.values(), si_fields)

    @cached_property
    def _raw_decoders(self) -> dict[int, Decoder]:
        return _compile_decoders(self.messages.values(), dbc_fields)

    @cached_property
    def _raw_encoders(self) -> dict[str, Encoder]:
        return _compile_encoders(self.messages.values(), dbc_fields)

    @cached_property
    def quantity_decoders(self) -> Mapping[int, Decoder]:
        """Identifier -> what `decode_quantities` calls for it."""
        return _compile_decoders(self.messages.values(), self._quantities)

    @cached_property
    def quantity_encoders(self) -> Mapping[str, Encoder]:
        """Name of a message -> what `encode_quantities` calls for it."""
        statements = {message.name: self._quantity_integers(message) for message in self.messages.values()}
        return _compile_functions("encode", self.messages.values(), statements)

    @cached_property
    def _packers(self) -> dict[str, Packer]:
        statements = {message.name: _packed_integers(message) for message in self.messages.values()}
        return _compile_functions("pack", self.messages.values(), statements)

    def decode(self, frame_id: int, data: bytes) -> Values | Fault:
        """Signals of a frame in SI, or why there are none."""
        try:
            return self._decoders[frame_id](data)
        except KeyError:
            return Fault(FaultKind.UNKNOWN_ID, frame_id, len(data))

    def decode_quantities(self, frame_id: int, data: bytes) -> Values | Fault:
        """Quantities of a frame, SI, and its `COUNTER` if it has one; or why there are none."""
        try:
            return self.quantity_decoders[frame_id](data)
        except KeyError:
            return Fault(FaultKind.UNKNOWN_ID, frame_id, len(data))

    def quantities(self, message: str) -> tuple[str, ...]:
        """Names of the quantities in a message."""
        return tuple(field.key for field in self._quantities(self.messages[message]) if field.key != COUNTER)

    def encode(self, name: str, values: Mapping[str, float]) -> tuple[int, bytes]:
        """(identifier, bytes) of a message from all its signals in SI, each held to what its field can carry.

        Raises:
            KeyError: no such message, or a signal is missing.
            ValueError: a signal the message does not have, or a value that is not a number.
        """
        return self._encoders[name](values)

    def encode_quantities(self, name: str, values: Mapping[str, float]) -> tuple[int, bytes]:
        """(identifier, bytes) of a message from its quantities; its other signals are at rest (`signals.toml`).

        Raises:
            KeyError: no such message, or a quantity is missing.
            ValueError: a value that is not a number.
        """
        return self.quantity_encoders[name](values)

    def pack(self, name: str, raw: Mapping[str, int]) -> tuple[int, bytes]:
        """(identifier, bytes) of a message from the integers of all its fields, each held to what its field can carry.

        Nothing is scaled or rounded: what was checked is what leaves.

        Raises:
            KeyError: no such message, or a signal is missing.
            ValueError: a signal the message does not have.
            TypeError, AttributeError: a value that is not an integer.
        """
        return self._packers[name](raw)

    def decode_raw(self, frame_id: int, data: bytes) -> Values | Fault:
        """`decode` in the units of the DBC."""
        try:
            return self._raw_decoders[frame_id](data)
        except KeyError:
            return Fault(FaultKind.UNKNOWN_ID, frame_id, len(data))

    def encode_raw(self, name: str, values: Mapping[str, float]) -> tuple[int, bytes]:
        """`encode` from the units of the DBC."""
        return self._raw_encoders[name](values)

    def _quantity_integers(self, message: BusMessage) -> list[str]:
        """Each signal once: by its first quantity, else as it rests."""
        set_by = {field.signal.name: field for field in reversed(self._quantities(message))}
        return [
            _clamped(index, set_by[signal.name]) if signal.name in set_by else f"r{index} = {self.at_rest(signal)}"
            for index, signal in enumerate(message.signals)
        ]

    def at_rest(self, signal: Signal) -> int:
        """Integer of a signal that no quantity sets: as `signals.toml` says, else what 0 is in units of the DBC."""
        return signal.raw(self.signals.constants.get(signal.name, self.signals.resting.get(signal.name, 0.0)))


@cache
def load_codec(platform: str = DEFAULT_PLATFORM) -> Codec:
    """The codec of a car, by its name or folder, compiled once a process.

    Raises:
        PlatformError: no such car, or a mistake in its folder.
    """
    folder = platform_folder(platform)
    database = load_database(folder)
    return Codec(database, read_signals(folder, database))


def si_fields(message: BusMessage) -> list[Field]:
    """Every signal in SI."""
    return [Field(s, s.si_name, s.scale * s.si_factor, s.offset * s.si_factor) for s in message.signals]


def dbc_fields(message: BusMessage) -> list[Field]:
    """Every signal in units of the DBC."""
    return [_dbc_field(signal) for signal in message.signals]


def _dbc_field(signal: Signal) -> Field:
    return Field(signal, signal.name, signal.scale, signal.offset)


def _quantities_of(signals: SignalMap) -> Fields:
    """Fields of the quantities in a message, and of its counter."""
    named: dict[str, list[tuple[str, Place]]] = {}
    for places in (signals.reports, signals.commands):
        for name, place in places.items():
            named.setdefault(place.message.name, []).append((name, place))

    def fields(message: BusMessage) -> list[Field]:
        found = [Field(p.signal, name, p.scale, p.zero) for name, p in named.get(message.name, ())]
        counted = [Field(message.signal[message.counter.signal], COUNTER, 1.0, 0.0)] if message.counter else []
        return found + counted

    return fields


def _compile_decoders(messages: Iterable[BusMessage], fields: Fields) -> dict[int, Decoder]:
    source = "\n".join(decoder_source(message, fields(message)) for message in messages)
    namespace = _run(source, messages)
    return {message.id: namespace[f"decode_{message.name}"] for message in messages}


def _compile_encoders(messages: Iterable[BusMessage], fields: Fields) -> dict[str, Encoder]:
    return _compile_functions("encode", messages, {m.name: _encoded_integers(m, fields(m)) for m in messages})


def _compile_functions(
    verb: str, messages: Iterable[BusMessage], statements: Mapping[str, list[str]]
) -> dict[str, Any]:
    """Functions from `values` to a frame, by name of the message; `statements` make the integer of each field."""
    source = "\n".join(_function(f"{verb}_{message.name}", message, statements[message.name]) for message in messages)
    namespace = _run(source, messages)
    return {message.name: namespace[f"{verb}_{message.name}"] for message in messages}


def _run(source: str, messages: Iterable[BusMessage]) -> dict[str, Any]:
    """Execute generated source: only names and numbers of a DBC, checked by its reader, go into it."""
    namespace: dict[str, Any] = {
        "integer": int.from_bytes,
        "wrong_length": partial(Fault, FaultKind.WRONG_LENGTH),
        "unknown_signals": _unknown_signals,
    }
    for message in messages:
        if words := _words(message):
            namespace[f"unpack_{message.name}"] = words.unpack
    exec(compile(source, "<can_dbc codecs>", "exec"), namespace)
    return namespace


def decoder_source(message: BusMessage, fields: list[Field]) -> str:
    """Source of `decode_NAME(data) -> values | Fault`.

    Signals that all lie on whole bytes are split by one `struct` call, others are cut out of one integer.
    """
    words = _words(message)
    if words is None:
        split = f"frame = integer(data, {message.byte_order!r})"
        raws = {signal.name: _cut_out(signal, message.dlc) for signal in message.signals}
    else:
        raws = {signal.name: f"r{index}" for index, signal in enumerate(message.signals)}
        by_start = sorted(message.signals, key=lambda signal: signal.first_byte)
        split = ", ".join(raws[signal.name] for signal in by_start) + f", = unpack_{message.name}(data)"
    values = (f"{field.key!r}: {_scaled(raws[field.signal.name], field)}" for field in fields)
    lines = [
        f"def decode_{message.name}(data):",
        f"    if len(data) != {message.dlc}:",
        f"        return wrong_length({message.id}, len(data), {message.dlc})",
        *([f"    {split}"] if fields else []),
        f"    return {{{', '.join(values)}}}",
    ]
    return "\n".join(lines)


def _encoded_integers(message: BusMessage, fields: list[Field]) -> list[str]:
    integers = [_clamped(index, field) for index, field in enumerate(fields)]
    return [_checked(message, [field.key for field in fields]), *integers]


def _packed_integers(message: BusMessage) -> list[str]:
    integers = [_clamped_field(index, signal) for index, signal in enumerate(message.signals)]
    return [_checked(message, [signal.name for signal in message.signals]), *integers]


def _checked(message: BusMessage, keys: list[str]) -> str:
    """Statement that refuses values of other names."""
    return f"if len(values) != {len(keys)}: unknown_signals({message.name!r}, {tuple(keys)!r}, values)"


def _function(name: str, message: BusMessage, statements: list[str]) -> str:
    """Source of a function from `values` to (identifier, bytes)."""
    lines = [
        f"def {name}(values):",
        *(f"    {line}" for line in statements),
        f"    return {message.id}, ({_packed(message)}).to_bytes({message.dlc}, {message.byte_order!r})",
    ]
    return "\n".join(lines)


_WORD = {8: "B", 16: "H", 32: "I"}


def _words(message: BusMessage) -> Struct | None:
    """Layout of a message whose signals are all whole 8, 16 or 32 bit words, else None."""
    layout, position = "<" if message.byte_order == "little" else ">", 0
    for signal in sorted(message.signals, key=lambda signal: signal.first_byte):
        aligned = signal.shift(message.dlc) % 8 == 0 and signal.length in _WORD
        if not aligned:
            return None
        word = _WORD[signal.length]
        layout += "x" * (signal.first_byte - position) + (word.lower() if signal.signed else word)
        position = signal.first_byte + signal.length // 8
    return Struct(layout + "x" * (message.dlc - position))


def _cut_out(signal: Signal, dlc: int) -> str:
    """Expression of one raw value; the sign is restored by flipping and subtracting the sign bit."""
    shift = signal.shift(dlc)
    raw = f"frame >> {shift}" if shift else "frame"
    mask = f" & {(1 << signal.length) - 1}" if shift + signal.length < dlc * 8 else ""
    if not signal.signed:
        return f"({raw}{mask})"
    sign = 1 << signal.length - 1
    return f"((({raw}{mask}) ^ {sign}) - {sign})"


def _scaled(raw: str, field: Field) -> str:
    """Expression of the physical value; a plain count stays an integer."""
    scaled = raw if field.scale == 1.0 else f"{raw} * {field.scale!r}"
    return scaled + (f" + {field.offset!r}" if field.offset else "")


def _clamped(index: int, field: Field) -> str:
    """Statement that puts the raw integer of one field into `r{index}`.

    Infinity is clamped before it could meet `round`; not-a-number passes both comparisons and `round` raises.
    """
    low, high = field.signal.raw_range
    value = f"values[{field.key!r}]" + (f" - {field.offset!r}" if field.offset else "")
    scale = field.scale
    exact = f"({value}) / {scale!r}" if field.offset else f"{value} / {scale!r}" if scale != 1.0 else value
    name = f"r{index}"
    return f"{name} = {exact}; {name} = {low} if {name} < {low} else {high} if {name} > {high} else round({name})"


def _clamped_field(index: int, signal: Signal) -> str:
    """Statement that puts an integer, held to what the field of one signal can carry, into `r{index}`."""
    low, high = signal.raw_range
    name = f"r{index}"
    return f"{name} = values[{signal.name!r}]; {name} = {low} if {name} < {low} else min({name}, {high})"


def _packed(message: BusMessage) -> str:
    """Expression of the frame as one integer of its own byte order."""
    parts = []
    for index, signal in enumerate(message.signals):
        raw = f"(r{index} & {(1 << signal.length) - 1})" if signal.signed else f"r{index}"
        shift = signal.shift(message.dlc)
        parts.append(f"{raw} << {shift}" if shift else raw)
    return " | ".join(parts)


def _unknown_signals(message: str, known: Iterable[str], values: Mapping[str, float]) -> None:
    """A wrong number of signals: name those the message lacks (missing ones raise KeyError by themselves)."""
    unknown = sorted(set(values) - set(known))
    if unknown:
        raise ValueError(f"{message} has no signal {', '.join(unknown)}")
