"""Frames to SI values and back, by straight-line functions compiled once at load.

For every message the source of a decoder and of an encoder is written out and compiled: no loop and no table
look-up is left for run time. `decode` and `encode` speak SI; `decode_raw` and `encode_raw` the units of the
DBC, for tools and tests. What arrives wrong from the wire is a `Fault` value, never an exception; a name that
does not exist or a value that is not a number comes from our own code and raises.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import cache, partial
from struct import Struct
from types import MappingProxyType
from typing import Any

from can_dbc.database import Database, Message, Signal, load_database

Values = dict[str, float]


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
        if self.kind is FaultKind.UNKNOWN_ID:
            return f"0x{self.frame_id:03X}: identifier not in the DBC"
        return f"0x{self.frame_id:03X}: {self.length} bytes, the DBC says {self.expected_length}"


Decoder = Callable[[bytes], Values | Fault]
Encoder = Callable[[Mapping[str, float]], tuple[int, bytes]]
Packer = Callable[[Mapping[str, int]], tuple[int, bytes]]


class Codec:
    """Compiled codecs of one database."""

    def __init__(self, database: Database) -> None:
        self.version = database.version
        self.sha256 = database.sha256
        self.messages: Mapping[str, Message] = MappingProxyType({m.name: m for m in database.messages})
        self.by_id: Mapping[int, Message] = MappingProxyType({m.id: m for m in database.messages})
        self._decoders = _compile_decoders(database.messages, si=True)
        self._encoders = _compile_encoders(database.messages, si=True)
        self._packers: dict[str, Packer] = _compile_packers(database.messages)
        self._raw: tuple[dict[int, Decoder], dict[str, Encoder]] | None = None

    def decode(self, frame_id: int, data: bytes) -> Values | Fault:
        """Signals of a frame in SI, or why there are none."""
        try:
            return self._decoders[frame_id](data)
        except KeyError:
            return Fault(FaultKind.UNKNOWN_ID, frame_id, len(data))

    def encode(self, name: str, values: Mapping[str, float]) -> tuple[int, bytes]:
        """(identifier, bytes) of a message from all its signals in SI, each held to what its field can carry.

        Raises:
            KeyError: no such message, or a signal is missing.
            ValueError: a signal the message does not have, or a value that is not a number.
        """
        return self._encoders[name](values)

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
        decoders, _ = self._raw_codecs()
        return decoders[frame_id](data) if frame_id in decoders else Fault(FaultKind.UNKNOWN_ID, frame_id, len(data))

    def encode_raw(self, name: str, values: Mapping[str, float]) -> tuple[int, bytes]:
        """`encode` from the units of the DBC."""
        _, encoders = self._raw_codecs()
        return encoders[name](values)

    def _raw_codecs(self) -> tuple[dict[int, Decoder], dict[str, Encoder]]:
        """Compiled at first use: only tools and tests need them."""
        if self._raw is None:
            messages = tuple(self.messages.values())
            self._raw = _compile_decoders(messages, si=False), _compile_encoders(messages, si=False)
        return self._raw


@cache
def load_codec() -> Codec:
    """The codec of the database shipped with this package, compiled once a process."""
    return Codec(load_database())


def _compile_decoders(messages: tuple[Message, ...], si: bool) -> dict[int, Decoder]:
    source = "\n".join(decoder_source(message, si) for message in messages)
    namespace = _run(source, messages)
    return {message.id: namespace[f"decode_{message.name}"] for message in messages}


def _compile_encoders(messages: tuple[Message, ...], si: bool) -> dict[str, Encoder]:
    source = "\n".join(encoder_source(message, si) for message in messages)
    namespace = _run(source, messages)
    return {message.name: namespace[f"encode_{message.name}"] for message in messages}


def _compile_packers(messages: tuple[Message, ...]) -> dict[str, Packer]:
    source = "\n".join(packer_source(message) for message in messages)
    namespace = _run(source, messages)
    return {message.name: namespace[f"pack_{message.name}"] for message in messages}


def _run(source: str, messages: tuple[Message, ...]) -> dict[str, Any]:
    """Execute generated source: only names and numbers of our own DBC, checked by its reader, go into it."""
    namespace: dict[str, Any] = {
        "integer": int.from_bytes,
        "wrong_length": partial(Fault, FaultKind.WRONG_LENGTH),
        "unknown_signals": _unknown_signals,
        "messages": {message.name: message for message in messages},
    }
    for message in messages:
        if words := _words(message):
            namespace[f"unpack_{message.name}"] = words.unpack
    exec(compile(source, "<can_dbc codecs>", "exec"), namespace)
    return namespace


def decoder_source(message: Message, si: bool) -> str:
    """Source of `decode_NAME(data) -> values | Fault`.

    Signals that all lie on whole bytes are split by one `struct` call, others are cut out of one integer.
    """
    words = _words(message)
    if words is None:
        split = f"frame = integer(data, {message.byte_order!r})"
        raws = [_cut_out(signal, message.dlc) for signal in message.signals]
    else:
        by_start = sorted(message.signals, key=lambda signal: signal.first_byte)
        split = (
            ", ".join(f"r{message.signals.index(signal)}" for signal in by_start) + f", = unpack_{message.name}(data)"
        )
        raws = [f"r{index}" for index in range(len(message.signals))]
    pairs = zip(raws, message.signals, strict=True)
    fields = (f"{_key(signal, si)!r}: {_scaled(raw, signal, si)}" for raw, signal in pairs)
    lines = [
        f"def decode_{message.name}(data):",
        f"    if len(data) != {message.dlc}:",
        f"        return wrong_length({message.id}, len(data), {message.dlc})",
        f"    {split}",
        f"    return {{{', '.join(fields)}}}",
    ]
    return "\n".join(lines)


def encoder_source(message: Message, si: bool) -> str:
    """Source of `encode_NAME(values) -> (identifier, bytes)`."""
    integers = [_clamped(index, signal, si) for index, signal in enumerate(message.signals)]
    return _function(f"encode_{message.name}", message, integers, si)


def packer_source(message: Message) -> str:
    """Source of `pack_NAME(values) -> (identifier, bytes)`."""
    integers = [_held(index, signal) for index, signal in enumerate(message.signals)]
    return _function(f"pack_{message.name}", message, integers, si=False)


def _function(name: str, message: Message, integers: list[str], si: bool) -> str:
    """Source of a function from `values` to a frame; `integers` are the statements that make each field's."""
    lines = [
        f"def {name}(values):",
        f"    if len(values) != {len(message.signals)}:",
        f"        unknown_signals(messages[{message.name!r}], values, {si})",
        *(f"    {line}" for line in integers),
        f"    return {message.id}, ({_packed(message)}).to_bytes({message.dlc}, {message.byte_order!r})",
    ]
    return "\n".join(lines)


def _key(signal: Signal, si: bool) -> str:
    return signal.si_name if si else signal.name


def _linear(signal: Signal, si: bool) -> tuple[float, float]:
    factor = signal.si_factor if si else 1.0
    return signal.scale * factor, signal.offset * factor


_WORD = {8: "B", 16: "H", 32: "I"}


def _words(message: Message) -> Struct | None:
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


def _scaled(raw: str, signal: Signal, si: bool) -> str:
    """Expression of the physical value; a plain count stays an integer."""
    scale, offset = _linear(signal, si)
    return (raw if scale == 1.0 else f"{raw} * {scale!r}") + (f" + {offset!r}" if offset else "")


def _clamped(index: int, signal: Signal, si: bool) -> str:
    """Statement that puts the raw integer of one signal into `r{index}`.

    Infinity is clamped before it could meet `round`; not-a-number passes both comparisons and `round` raises.
    """
    scale, offset = _linear(signal, si)
    low, high = signal.raw_range
    value = f"values[{_key(signal, si)!r}]" + (f" - {offset!r}" if offset else "")
    exact = f"({value}) / {scale!r}" if offset else f"{value} / {scale!r}" if scale != 1.0 else value
    name = f"r{index}"
    return f"{name} = {exact}; {name} = {low} if {name} < {low} else {high} if {name} > {high} else round({name})"


def _held(index: int, signal: Signal) -> str:
    """Statement that puts an integer, held to what the field of one signal can carry, into `r{index}`."""
    low, high = signal.raw_range
    return f"r{index} = min(max(values[{signal.name!r}], {low}), {high})"


def _packed(message: Message) -> str:
    """Expression of the frame as one integer of its own byte order."""
    parts = []
    for index, signal in enumerate(message.signals):
        raw = f"(r{index} & {(1 << signal.length) - 1})" if signal.signed else f"r{index}"
        shift = signal.shift(message.dlc)
        parts.append(f"{raw} << {shift}" if shift else raw)
    return " | ".join(parts)


def _unknown_signals(message: Message, values: Mapping[str, float], si: bool) -> None:
    """A wrong number of signals: name those the message lacks (missing ones raise KeyError by themselves)."""
    unknown = sorted(set(values) - {_key(signal, si) for signal in message.signals})
    if unknown:
        raise ValueError(f"{message.name} has no signal {', '.join(unknown)}")
