"""What can go wrong, drawn from a seed: one to three faults, each with a beginning, a duration and a strength."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

from can_dbc.codec import Codec, Fault, load_codec
from hil_gateway.bus.messages import Message
from hil_gateway.bus.topics import APPLIED, BELIEF, COMMAND, ESTIMATE, MODEL_REVISION, PLAN, VEHICLE_STATE, Topic
from hil_gateway.can_link import Frame
from hil_gateway.process.clock import NS_PER_S
from planner.simulation.loop import Faults


class Kind(StrEnum):
    """The catalogue."""

    FRAME_DROP = "frames dropped"
    FRAME_DELAY = "frames delayed"
    FRAME_DUPLICATE = "frames duplicated"
    FRAME_REORDER = "frames reordered"
    FRAME_CORRUPT = "frames corrupted"
    MESSAGE_DROP = "messages dropped"
    MESSAGE_DELAY = "messages delayed"
    MESSAGE_DUPLICATE = "messages duplicated"
    MESSAGE_REORDER = "messages reordered"
    MESSAGE_CORRUPT = "messages corrupted"
    PAUSE = "process paused"
    KILL = "process killed"
    CLOCK_JUMP = "clock jumps"
    SENSOR_STUCK = "sensor stuck"
    SENSOR_NOISY = "sensor noisy"
    BUS_OFF = "bus off"


PROCESSES = ("gateway", "estimator", "planner")
TOPICS: tuple[Topic[Any], ...] = (VEHICLE_STATE, APPLIED, ESTIMATE, BELIEF, MODEL_REVISION, PLAN, COMMAND)
SENSORS: Mapping[str, tuple[str, ...]] = {
    "imu_1": ("imu_yaw_rate", "imu_ay"),
    "imu_2": ("imu_ax",),
    "wheel_speed_report": ("wheel_speed_FL", "wheel_speed_FR", "wheel_speed_RL", "wheel_speed_RR"),
    "steering_report_extd": ("average_steering_ang_fdbk",),
    "brake_pressure_report": ("brake_pressure_fdbk_front",),
    "novatel_report": ("novatel_lat", "novatel_long"),
}
HOSTILE = (0.0, -1e7, 1e7, 1e4, -1e4, 190.0, -190.0, 1.0, 5e-324)


HOSTILE_INTEGERS = (0, -1, 1, 255, 1 << 31, 1 << 62, 1 << 64, 10**400)


@dataclass(frozen=True)
class Episode:
    """One fault."""

    kind: Kind
    target: str
    """receiver of frames, topic key, process or sensor message"""
    start_ns: int
    end_ns: int
    strength: float
    """probability, delay (s), jump (s) or noise, by kind"""

    def active(self, now_ns: int) -> bool:
        """Whether it acts now."""
        return self.start_ns <= now_ns < self.end_ns

    def __str__(self) -> str:
        start, length = self.start_ns / NS_PER_S, (self.end_ns - self.start_ns) / NS_PER_S
        return f"{self.kind.value}: {self.target}, from {start:.2f} s for {length:.2f} s, strength {self.strength:.3g}"


def draw(seed: int, begin_ns: int) -> tuple[Episode, ...]:
    """Episodes of a seed; the catalogue is gone through in turn, so that every kind gets its share."""
    rng = random.Random(seed)
    kinds = list(Kind)
    chosen = [kinds[seed % len(kinds)], *rng.sample(kinds, k=rng.choice((0, 0, 0, 1, 2)))]
    return tuple(_episode(rng, kind, begin_ns) for kind in chosen)


def _episode(rng: random.Random, kind: Kind, begin_ns: int) -> Episode:
    start_ns = begin_ns + int(rng.uniform(0.1, 0.6) * NS_PER_S)
    length_s = rng.choice((0.03, 0.08, 0.15, 0.4, 1.0, math.inf))
    strength = rng.choice((0.05, 0.2, 0.5, 1.0))
    if kind in (Kind.KILL, Kind.PAUSE):
        target = rng.choice(PROCESSES)
        length_s = math.inf if kind is Kind.KILL else min(length_s, 1.0)
    elif kind.name.startswith("FRAME"):
        target = rng.choice(("gateway", "plant"))
        strength = rng.choice((0.01, 0.03, 0.15)) if kind is Kind.FRAME_DELAY else strength
    elif kind.name.startswith("MESSAGE"):
        target = rng.choice(TOPICS).key
        late = kind in (Kind.MESSAGE_DELAY, Kind.MESSAGE_REORDER)
        strength = rng.choice((0.01, 0.05, 0.2, 0.6)) if late else strength
    elif kind in (Kind.SENSOR_STUCK, Kind.SENSOR_NOISY):
        target = rng.choice(sorted(SENSORS))
    else:
        target = "wire" if kind is Kind.BUS_OFF else "clock"
        length_s = min(length_s, 1.0) if kind is Kind.BUS_OFF else 0.01
        strength = rng.choice((0.02, 0.06, 0.15, 0.7, 5.0)) if kind is Kind.CLOCK_JUMP else strength
    end_ns = start_ns + (10**15 if math.isinf(length_s) else int(length_s * NS_PER_S))
    return Episode(kind, target, start_ns, end_ns, strength)


class SeededFaults(Faults):
    """The faults of one seed, acting at the three places where the loop lets them in."""

    def __init__(self, seed: int, episodes: tuple[Episode, ...]) -> None:
        self.episodes = episodes
        self._rng = random.Random(seed ^ 0x5EED)
        self._codec: Codec = load_codec()
        self._held: dict[str, list[tuple[int, Frame]]] = {}
        self._stuck: dict[int, dict[str, float]] = {}

    def jump_ns(self, now_ns: int) -> int:
        """How far time jumps in this tick, ns."""
        jumps = (e for e in self.episodes if e.kind is Kind.CLOCK_JUMP and e.active(now_ns))
        return sum(int(episode.strength * NS_PER_S) for episode in jumps)

    def bus_off(self, now_ns: int) -> bool:
        """Whether the wire is dead."""
        return any(episode.kind is Kind.BUS_OFF and episode.active(now_ns) for episode in self.episodes)

    def runs(self, now_ns: int, component: str) -> bool:
        return not any(
            episode.kind in (Kind.PAUSE, Kind.KILL) and episode.target == component and episode.active(now_ns)
            for episode in self.episodes
        )

    def frames(self, now_ns: int, receiver: str, frames: list[Frame]) -> list[Frame]:
        released = self._release(now_ns, receiver)
        for episode in self.episodes:
            if not episode.active(now_ns):
                continue
            if episode.target == receiver and episode.kind in _FRAME_FAULTS:
                frames = _FRAME_FAULTS[episode.kind](self, episode, now_ns, frames)
            elif receiver == "gateway" and episode.kind in (Kind.SENSOR_STUCK, Kind.SENSOR_NOISY):
                frames = [self._falsify(episode, frame) for frame in frames]
        return released + frames

    def messages(self, now_ns: int, topic: Topic[Any], message: Message) -> Iterable[tuple[int, Message]]:
        deliveries = [(now_ns, message)]
        for episode in self.episodes:
            if episode.target == topic.key and episode.active(now_ns) and episode.kind in _MESSAGE_FAULTS:
                deliveries = _MESSAGE_FAULTS[episode.kind](self, episode, deliveries)
        return deliveries

    def _release(self, now_ns: int, receiver: str) -> list[Frame]:
        held = self._held.get(receiver, [])
        self._held[receiver] = [entry for entry in held if entry[0] > now_ns]
        return [frame for due_ns, frame in held if due_ns <= now_ns]

    def _drop(self, episode: Episode, now_ns: int, frames: list[Frame]) -> list[Frame]:
        return [frame for frame in frames if self._rng.random() >= episode.strength]

    def _delay(self, episode: Episode, now_ns: int, frames: list[Frame]) -> list[Frame]:
        due_ns = now_ns + int(episode.strength * NS_PER_S)
        self._held[episode.target] += [(due_ns, frame) for frame in frames]
        return []

    def _duplicate(self, episode: Episode, now_ns: int, frames: list[Frame]) -> list[Frame]:
        return [frame for frame in frames for _ in range(1 + (self._rng.random() < episode.strength))]

    def _reorder(self, episode: Episode, now_ns: int, frames: list[Frame]) -> list[Frame]:
        mixed = list(frames)
        if self._rng.random() < episode.strength:
            self._rng.shuffle(mixed)
        return mixed

    def _corrupt(self, episode: Episode, now_ns: int, frames: list[Frame]) -> list[Frame]:
        return [self._damage(frame) if self._rng.random() < episode.strength else frame for frame in frames]

    def _damage(self, frame: Frame) -> Frame:
        """Other bytes, another length or another identifier: what a checksum-less bus can deliver."""
        rng = self._rng
        what = rng.randrange(3)
        if what == 0 and frame.data:
            flipped = bytearray(frame.data)
            flipped[rng.randrange(len(flipped))] ^= 1 << rng.randrange(8)
            return replace(frame, data=bytes(flipped))
        if what == 1:
            return replace(frame, data=rng.randbytes(rng.randrange(9)))
        return replace(frame, id=rng.randrange(2048))

    def _falsify(self, episode: Episode, frame: Frame) -> Frame:
        layout = self._codec.by_id.get(frame.id)
        if layout is None or layout.name != episode.target:
            return frame
        values = self._codec.decode(frame.id, frame.data)
        if isinstance(values, Fault):
            return frame
        names = SENSORS[layout.name]
        if episode.kind is Kind.SENSOR_STUCK:
            values.update(self._stuck.setdefault(frame.id, {name: values[name] for name in names}))
        else:
            spread = {name: layout.signal[name].si_resolution * 400 * episode.strength for name in names}
            values.update({name: values[name] + self._rng.gauss(0, spread[name]) for name in names})
        return replace(frame, data=self._codec.encode(layout.name, values)[1])

    def _lose(self, episode: Episode, deliveries: list[tuple[int, Message]]) -> list[tuple[int, Message]]:
        return [] if self._rng.random() < episode.strength else deliveries

    def _late(self, episode: Episode, deliveries: list[tuple[int, Message]]) -> list[tuple[int, Message]]:
        return [(due + int(episode.strength * NS_PER_S), message) for due, message in deliveries]

    def _shuffle(self, episode: Episode, deliveries: list[tuple[int, Message]]) -> list[tuple[int, Message]]:
        longest = int(episode.strength * NS_PER_S)
        return [(due + self._rng.randrange(longest), message) for due, message in deliveries]

    def _repeat(self, episode: Episode, deliveries: list[tuple[int, Message]]) -> list[tuple[int, Message]]:
        again = [(due + self._rng.randrange(NS_PER_S // 20), message) for due, message in deliveries]
        return deliveries + again if self._rng.random() < episode.strength else deliveries

    def _distort(self, episode: Episode, deliveries: list[tuple[int, Message]]) -> list[tuple[int, Message]]:
        """Contents a sender could have put in by mistake; what its schema refuses never reaches a reader."""
        return [(due, self._distorted(message)) for due, message in deliveries if self._rng.random() < episode.strength]

    def _distorted(self, message: Message) -> Message:
        content = message.model_dump()
        name = self._rng.choice(sorted(content))
        try:
            return type(message).model_validate({**content, name: self._mistaken(content[name])})
        except ValueError:
            return message

    def _mistaken(self, value: Any) -> Any:
        """Another value of the same kind: hostile numbers, arrays too short, too long or spoilt in one place."""
        rng = self._rng
        match value:
            case bool():
                return not value
            case int():
                return rng.choice(HOSTILE_INTEGERS)
            case float():
                return rng.choice(HOSTILE)
            case tuple() if value:
                i = rng.randrange(len(value))
                spoilt = (*value[:i], self._mistaken(value[i]), *value[i + 1 :])
                return rng.choice(((), value[:-1], value + value[-1:], spoilt))
            case dict() if value:
                name = rng.choice(sorted(value))
                rest = {key: kept for key, kept in value.items() if key != name}
                return rng.choice((rest, {**rest, name: self._mistaken(value[name])}))
        return value


_FRAME_FAULTS: Mapping[Kind, Callable[[SeededFaults, Episode, int, list[Frame]], list[Frame]]] = {
    Kind.FRAME_DROP: SeededFaults._drop,
    Kind.FRAME_DELAY: SeededFaults._delay,
    Kind.FRAME_DUPLICATE: SeededFaults._duplicate,
    Kind.FRAME_REORDER: SeededFaults._reorder,
    Kind.FRAME_CORRUPT: SeededFaults._corrupt,
}
_MESSAGE_FAULTS: Mapping[Kind, Callable[[SeededFaults, Episode, list[tuple[int, Message]]], list[tuple[int, Message]]]]
_MESSAGE_FAULTS = {
    Kind.MESSAGE_DROP: SeededFaults._lose,
    Kind.MESSAGE_DELAY: SeededFaults._late,
    Kind.MESSAGE_REORDER: SeededFaults._shuffle,
    Kind.MESSAGE_DUPLICATE: SeededFaults._repeat,
    Kind.MESSAGE_CORRUPT: SeededFaults._distort,
}
