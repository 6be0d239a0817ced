"""What a stretch of traffic contained: per message its times, lengths, counter and values. Pure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from can_dbc.codec import COUNTER, Codec, Fault, Values
from can_dbc.database import BusMessage
from can_dbc.signals import SignalMap
from hil_gateway.can_link import EXTENDED_ID, Frame
from hil_gateway.process.arrays import Array
from hil_gateway.process.clock import NS_PER_S

FOLLOWED = ("imu.", "wheel_speed_", "steering_motor", "heartbeat", "receiver.")
"""beginnings of the quantities that are kept over time for the plausibility checks"""
EXTENDED_BITS = 20
"""that a 29-bit identifier adds to a frame: 18 bits of it, SRR and r1 (ISO 11898-1)"""


@dataclass
class TrafficRecord:
    """Everything seen of one message."""

    layout: BusMessage
    stamps: list[int] = field(default_factory=list)
    wrong_lengths: Counter[int] = field(default_factory=Counter)
    steps: Counter[int] = field(default_factory=Counter)
    """counter differences between successive frames, modulo -> how often"""
    newest: Values = field(default_factory=dict)
    lowest: Values = field(default_factory=dict)
    highest: Values = field(default_factory=dict)

    @property
    def frames(self) -> int:
        """Number of frames that could be decoded."""
        return len(self.stamps)

    def rate_hz(self, seconds: float) -> float:
        """Frames per second over the whole stretch: a message that stopped half-way shows half its rate."""
        return self.frames / seconds

    def longest_gap_s(self, start_ns: int, end_ns: int) -> float:
        """Longest time without this message, the two ends of the stretch included."""
        times = [start_ns, *self.stamps, end_ns]
        return max(b - a for a, b in pairwise(times)) / NS_PER_S


@dataclass
class Observation:
    """All frames of a stretch of `seconds`, sorted out."""

    start_ns: int
    end_ns: int
    records: dict[str, TrafficRecord]
    unknown: Counter[int]
    error_frames: int
    bits: int
    """frame bits without stuffing: 44 + 8 n of a standard frame and 3 between frames (ISO 11898-1)"""
    stuff_bits_max: int
    """what bit stuffing can add at most: one bit in four of the 34 + 8 n it applies to"""
    backward_stamps: int
    series: dict[str, tuple[Array, Array]]
    """quantity -> (time s, value SI) of those `FOLLOWED`"""
    signals: SignalMap
    """of the car"""

    def newest(self, quantity: str) -> float | None:
        """Last value of a quantity, SI; None where it never came."""
        place = self.signals.reports.get(quantity)
        return None if place is None else self.records[place.message.name].newest.get(quantity)

    @property
    def seconds(self) -> float:
        """Length of the stretch."""
        return (self.end_ns - self.start_ns) / NS_PER_S

    @property
    def frames(self) -> int:
        """Data frames, known or not."""
        known = sum(record.frames + record.wrong_lengths.total() for record in self.records.values())
        return known + self.unknown.total()


def observe(frames: Iterable[Frame], codec: Codec, start_ns: int, end_ns: int) -> Observation:
    """Sort out `frames` received between two monotonic times."""
    seen = Observation(
        start_ns,
        end_ns,
        {m.name: TrafficRecord(m) for m in codec.messages.values()},
        Counter(),
        0,
        0,
        0,
        0,
        {},
        codec.signals,
    )
    last_ns = start_ns
    names = [name for name in codec.signals.reports if name.startswith(FOLLOWED)]
    followed: dict[str, list[tuple[int, Values]]] = {codec.signals.reports[n].message.name: [] for n in names}
    for frame in frames:
        seen.backward_stamps += frame.stamp_ns < last_ns
        last_ns = frame.stamp_ns
        if frame.is_error:
            seen.error_frames += 1
            continue
        payload_bits = 8 * len(frame.data) + (EXTENDED_BITS if frame.id & EXTENDED_ID else 0)
        seen.bits += 47 + payload_bits
        seen.stuff_bits_max += (34 + payload_bits - 1) // 4
        values = codec.decode_quantities(frame.id, frame.data)
        if isinstance(values, Fault):
            _take_fault(seen, codec, frame)
            continue
        name = codec.by_id[frame.id].name
        _take_values(seen.records[name], frame.stamp_ns, values)
        if name in followed:
            followed[name].append((frame.stamp_ns, values))
    for name in names:
        samples = followed[codec.signals.reports[name].message.name]
        times = np.array([(stamp - start_ns) / NS_PER_S for stamp, _ in samples])
        seen.series[name] = times, np.array([values[name] for _, values in samples], dtype=np.float64)
    return seen


def _take_fault(seen: Observation, codec: Codec, frame: Frame) -> None:
    layout = codec.by_id.get(frame.id)
    if layout is None:
        seen.unknown[frame.id] += 1
    else:
        seen.records[layout.name].wrong_lengths[len(frame.data)] += 1


def _take_values(record: TrafficRecord, stamp_ns: int, values: Values) -> None:
    counter = record.layout.counter
    if counter and record.newest:
        step = int(values[COUNTER] - record.newest[COUNTER]) % counter.modulus
        record.steps[step] += 1
    record.stamps.append(stamp_ns)
    if not record.newest:
        record.lowest, record.highest = dict(values), dict(values)
    for signal, value in values.items():
        record.lowest[signal] = min(record.lowest[signal], value)
        record.highest[signal] = max(record.highest[signal], value)
    record.newest = values
