"""The drive messages of a bag as sources: what one topic says, at the times it was measured.

A header's stamp is used, for NovAtel the receiver's own time, which the driver's stamp is later than by the transport.
Reports that are sent again with their old stamp count once.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from estimator.drive_log.bag.layout import Columns
from estimator.drive_log.bag.messages import MESSAGES, Message, kinds
from estimator.drive_log.bag.types import SAMPLES, full_name, of_generation, written
from hil_gateway.config import Config
from hil_gateway.process.arrays import Array, Ints
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.receiver.clock import LEAP_S
from hil_gateway.receiver.oem7 import GPS_EPOCH_UNIX_S, WEEK_S
from hil_gateway.session.files.configuration import config_of
from hil_gateway.session.files.format import METADATA_SESSION
from hil_gateway.session.files.reader import Item
from hil_gateway.session.logs.raw_bag import Bag

STRAY_S = 600.0
"""A stamp so far from the others of its topic is damaged: no message waits so long in a computer"""
SAME_CLOCK_S = 0.5
"""Computer and receiver less apart are on one time, and what lies between is the transport"""


@dataclass(frozen=True)
class BagSource:
    """One topic: quantity -> values (n,) at times t (n,), s after the bag's first message."""

    topic: str
    message: Message
    t: Array
    quantities: Mapping[str, Array]

    @property
    def rate(self) -> float:
        """Samples per second."""
        return 1.0 / float(np.median(np.diff(self.t))) if len(self.t) > 1 else 0.0


@dataclass
class _Topic:
    columns: Columns
    stamps: list[int] = field(default_factory=list)
    """Unix ns at which the recorder took each message in"""


@dataclass
class BagDrive:
    """Sources of a bag, and what is to be said of reading it."""

    path: Path
    sources: list[BagSource] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    other: Counter[str] = field(default_factory=Counter)
    """kinds of topics that say nothing of a drive"""
    config: Config = field(default_factory=Config)
    """of the session that the bag was exported from, else the default one"""


def read_sources(path: Path) -> BagDrive:
    """Every drive message of a bag.

    Raises:
        InputError: no bag.
    """
    bag, drive = Bag(path, kinds=frozenset(kinds())), BagDrive(path)
    topics: dict[str, _Topic] = {}
    waiting: dict[str, list[Item]] = {}
    for item in bag.items():
        if item.topic in topics:
            _add(topics[item.topic], item)
        elif (definitions := written(item.stream)) is not None:
            topics[item.topic] = _Topic(Columns(full_name(item.stream.kind), definitions))
            _add(topics[item.topic], item)
        else:
            waiting.setdefault(item.topic, []).append(item)
    _read_unnamed(waiting, topics, drive)
    drive.config = config_of(bag.metadata.get(METADATA_SESSION, {}))
    drive.notes += [f"damaged: {damage}" for damage in bag.damage]
    drive.other = Counter(stream.kind for stream in bag.streams.values() if full_name(stream.kind) not in MESSAGES)
    start_ns = min((min(topic.stamps) for topic in topics.values()), default=0)
    _make_sources(topics, start_ns, drive)
    return drive


def _add(topic: _Topic, item: Item) -> None:
    topic.columns.add(item.data)
    topic.stamps.append(item.log_ns)


def _read_unnamed(waiting: Mapping[str, list[Item]], topics: dict[str, _Topic], drive: BagDrive) -> None:
    """Topics the bag has no definitions of, by the generation of each package that reads most."""
    samples: dict[str, dict[str, list[bytes]]] = {}
    for items in waiting.values():
        kind = full_name(items[0].stream.kind)
        samples.setdefault(kind.partition("/")[0], {}).setdefault(kind, []).extend(i.data for i in items[:SAMPLES])
    for package, of_package in samples.items():
        generation, definitions = of_generation(package, of_package)
        if generation:
            drive.notes.append(f"the bag has no definitions of {package}: those of {generation} read its messages")
        for topic, items in waiting.items():
            kind = full_name(items[0].stream.kind)
            if kind.startswith(f"{package}/"):
                topics[topic] = _Topic(Columns(kind, definitions))
                for item in items:
                    _add(topics[topic], item)


def _make_sources(topics: Mapping[str, _Topic], start_ns: int, drive: BagDrive) -> None:
    clocks = {name: _Stamps.of(topic, start_ns) for name, topic in topics.items()}
    lead = min((c.late for c in clocks.values() if c.late is not None), default=0.0)
    apart = lead if abs(lead) > SAME_CLOCK_S else 0.0
    if apart:
        drive.notes.append(f"the receivers' clock is {apart:+.6g} s off the computer's: moved by that")
    for name, topic in topics.items():
        message = MESSAGES[topic.columns.kind]
        try:
            quantities = message.quantities(topic.columns)
        except KeyError as missing:
            drive.notes.append(f"{name}: a {topic.columns.kind} without {missing}: left out")
            continue
        if topic.columns.unreadable:
            drive.notes.append(f"{name}: {topic.columns.unreadable} messages are no {topic.columns.kind}: left out")
        source = _in_order(name, message, clocks[name].measured(apart), quantities, drive)
        if source is not None:
            drive.sources.append(source)
            late = clocks[name].late
            if late is not None and late - apart > 1e-3:
                drive.notes.append(f"{name}: published {1e3 * (late - apart):.0f} ms after it was measured: put back")


@dataclass(frozen=True)
class _Stamps:
    """Times of one topic, s after the bag's first message: by the driver or recorder, and by a receiver."""

    host: Array
    receiver: Array | None

    @property
    def late(self) -> float | None:
        """Median time from measurement to publication by the two clocks, s; None without a receiver's."""
        return None if self.receiver is None else float(np.median(self.host - self.receiver))

    def measured(self, apart: float) -> Array:
        """When the receiver measured, on the computer's clock; else the stamps."""
        return self.host if self.receiver is None else self.receiver + apart

    @classmethod
    def of(cls, topic: _Topic, start_ns: int) -> _Stamps:
        message = MESSAGES[topic.columns.kind]
        logged = np.array(topic.stamps, dtype=np.int64)
        stamped = _ns(topic.columns, message.stamp)
        host = (logged - start_ns) / NS_PER_S
        if stamped is not None and (stamped > 0).all():
            host = _without_strays((stamped - start_ns) / NS_PER_S, host)
        receiver = _gps(topic.columns, start_ns)
        return cls(host, None if receiver is None else _without_strays(receiver, host))


def _without_strays(t: Array, logged: Array) -> Array:
    """Stamps (n,), and where one is far from the others, seen from when it was recorded, what they say of that."""
    apart = float(np.median(t - logged))
    return np.where(np.abs(t - logged - apart) < STRAY_S, t, logged + apart)


def _ns(columns: Columns, path: str) -> Ints | None:
    try:
        return np.asarray(columns.get(f"{path}.sec", int) * NS_PER_S + columns.get(f"{path}.nanosec", int))
    except KeyError:
        return None


def _gps(columns: Columns, start_ns: int) -> Array | None:
    try:
        weeks = columns.get("nov_header.gps_week_number", int)
        ms = columns.get("nov_header.gps_week_milliseconds", int)
    except KeyError:
        return None
    if not (weeks > 0).all():
        return None
    unix_s = GPS_EPOCH_UNIX_S + WEEK_S * weeks - LEAP_S
    return np.asarray((unix_s * 1000 + ms - start_ns // 1_000_000) / 1e3 - (start_ns % 1_000_000) / NS_PER_S)


def _in_order(
    topic: str, message: Message, t: Array, quantities: Mapping[str, Array], drive: BagDrive
) -> BagSource | None:
    """Samples at times that increase, without those that say nothing; None where none are left."""
    there = np.any([np.isfinite(values) for values in quantities.values()], axis=0)
    newest = np.maximum.accumulate(np.where(there, t, -np.inf))
    keep = there & (t > np.concatenate([[-np.inf], newest[:-1]]))
    again = int(there.sum() - keep.sum())
    if again:
        drive.notes.append(f"{topic}: {again} messages are sent again with an old stamp: each counts once")
    if keep.sum() < 2:
        drive.notes.append(f"{topic}: no two messages with a valid solution: left out")
        return None
    return BagSource(topic, message, t[keep], {name: values[keep] for name, values in quantities.items()})
