"""What is on a CAN bus, decoded: rate, age, counter and signals of every identifier, and what has changed. Pure."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from can_dbc.codec import Codec, Fault
from can_dbc.database import BusMessage
from hil_gateway.can_link import EXTENDED_ID, Frame
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.process.figures import figure

RATE_FRAMES = 50
"""frames a rate is measured over"""
CHANGED_NS = NS_PER_S
"""a value that has changed within this is shown as changed"""


@dataclass
class FrameStream:
    """One identifier; values in the units of the DBC."""

    frame_id: int
    message: BusMessage | None
    count: int = 0
    counter_errors: int = 0
    last_ns: int = 0
    data: bytes = b""
    fault: str = ""
    values: dict[str, float] = field(default_factory=dict)
    changed_ns: dict[str, int] = field(default_factory=dict)
    stamps: deque[int] = field(default_factory=lambda: deque(maxlen=RATE_FRAMES))

    @property
    def name(self) -> str:
        """Of the DBC, or the identifier alone."""
        return self.message.name if self.message else "unknown"

    @property
    def rate_hz(self) -> float | None:
        """Over the last frames; None for a single one."""
        span_ns = self.stamps[-1] - self.stamps[0]
        return None if span_ns <= 0 else (len(self.stamps) - 1) * NS_PER_S / span_ns

    def late(self, now_ns: int) -> bool:
        """Whether it is older than the DBC's deadline."""
        return self.message is not None and now_ns - self.last_ns > self.message.deadline_s * NS_PER_S

    def take(self, frame: Frame, codec: Codec) -> None:
        """One frame of this identifier."""
        self.count += 1
        self.last_ns, self.data = frame.stamp_ns, frame.data
        self.stamps.append(frame.stamp_ns)
        decoded = codec.decode_raw(frame.id, frame.data) if self.message else {}
        if isinstance(decoded, Fault):
            self.fault, decoded = str(decoded), {}
        self._check_counter(decoded)
        for name, value in decoded.items():
            if name in self.values and value != self.values[name] and name != self._counter:
                self.changed_ns[name] = frame.stamp_ns
        self.values = decoded

    @property
    def _counter(self) -> str:
        return self.message.counter.signal if self.message and self.message.counter else ""

    def _check_counter(self, decoded: dict[str, float]) -> None:
        counter = self.message.counter if self.message else None
        if counter is None or counter.signal not in decoded or counter.signal not in self.values:
            return
        expected = (self.values[counter.signal] + 1) % counter.modulus
        self.counter_errors += decoded[counter.signal] != expected


class FrameMonitor:
    """Every identifier heard; `take` with what has arrived."""

    def __init__(self, codec: Codec, filters: Sequence[str] = ()) -> None:
        self._codec, self._filters = codec, [text.lower() for text in filters]
        self.streams: dict[int, FrameStream] = {}
        self.frames = self.errors = self.last_ns = 0

    def take(self, frames: Iterable[Frame]) -> None:
        """In the order they were heard."""
        for frame in frames:
            self.frames += 1
            self.last_ns = max(self.last_ns, frame.stamp_ns)
            if frame.is_error:
                self.errors += 1
                continue
            stream = self.streams.get(frame.id)
            if stream is None:
                stream = self.streams[frame.id] = FrameStream(frame.id, self._codec.by_id.get(frame.id))
            stream.take(frame, self._codec)

    def shown(self) -> list[FrameStream]:
        """Streams that a filter names by identifier, message or signal, in order of identifier; all without filters."""
        return [stream for _, stream in sorted(self.streams.items()) if self._passes(stream)]

    def _passes(self, stream: FrameStream) -> bool:
        words = [f"0x{stream.frame_id & ~EXTENDED_ID:03x}", stream.name, *stream.values]
        return not self._filters or any(text in word.lower() for text in self._filters for word in words)


def cells(stream: FrameStream, now_ns: int) -> tuple[str, str, str, str, str]:
    """Identifier, name, rate, age, counter, as text."""
    rate = "-" if stream.rate_hz is None else f"{stream.rate_hz:.1f} Hz"
    counter = "-" if stream.message is None or stream.message.counter is None else f"{stream.counter_errors} wrong"
    age_ms = (now_ns - stream.last_ns) / 1e6
    return f"0x{stream.frame_id & ~EXTENDED_ID:03X}", stream.name, rate, f"{age_ms:.0f} ms", counter


def signals(stream: FrameStream, now_ns: int) -> list[tuple[str, bool]]:
    """`name=value unit` of every signal, and whether it has just changed; bytes where nothing can be decoded."""
    if stream.fault or stream.message is None:
        return [(stream.fault or stream.data.hex(" "), False)]
    return [
        (
            f"{name}={figure(value, stream.message.signal[name].unit)}",
            now_ns - stream.changed_ns.get(name, -CHANGED_NS) < CHANGED_NS,
        )
        for name, value in stream.values.items()
    ]


def line(stream: FrameStream, now_ns: int) -> str:
    """One stream in one plain line; what has just changed has a star."""
    marked = "  ".join(f"{text}*" if changed else text for text, changed in signals(stream, now_ns))
    late = " LATE" if stream.late(now_ns) else ""
    frame_id, name, rate, age, counter = cells(stream, now_ns)
    return f"{frame_id} {name} {rate}, {age} old{late}, counter {counter}: {marked}"
