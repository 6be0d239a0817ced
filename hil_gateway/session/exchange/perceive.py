"""Raw frames of any logger -> vehicle states, by the gateway itself, run over the frames in listen mode."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hil_gateway.bus.interface import LocalBus
from hil_gateway.bus.messages import Message, VehicleState
from hil_gateway.bus.topics import EVENT, GATEWAY_STATUS, TYRES, VEHICLE_STATE, Topic
from hil_gateway.can_link import Frame
from hil_gateway.config import Config
from hil_gateway.gateway.check.arming import PlaybackLink
from hil_gateway.gateway.core import Gateway
from hil_gateway.gateway.events.log import EventLog
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.process.errors import InputError
from hil_gateway.session.files.format import CAN_TOPIC, METADATA_SESSION, named, unpack_frame
from hil_gateway.session.files.format import software_version as software
from hil_gateway.session.files.output import output_file
from hil_gateway.session.files.reader import SessionReader
from hil_gateway.session.files.writer import FLUSH_EVERY, SessionFile
from hil_gateway.settings.gateway import PERIOD_NS

KEPT: tuple[Topic[Any], ...] = (VEHICLE_STATE, GATEWAY_STATUS, TYRES, EVENT)
LONGEST_GAP_NS = 10 * NS_PER_S
"""no states are made for longer than this of silence: the log was stopped in between"""


@dataclass
class Perceived:
    """What the gateway made of the frames."""

    states: int = 0
    valid: int = 0
    never_heard: set[str] = field(default_factory=set)
    """groups of reports of which no frame ever came"""

    def note(self, state: VehicleState) -> None:
        """Count one state."""
        if not self.states:
            self.never_heard = set(state.sources)
        self.states += 1
        self.valid += state.valid
        self.never_heard -= {name for name, source in state.sources.items() if source.age_s is not None}


def perceive(source: Path, target: Path, config: Config) -> Perceived:
    """Write the frames of `source` with the vehicle states the gateway makes of them, every 10 ms.

    Raises:
        InputError: no recording, no frames in it, `target` cannot be written.
    """
    listening = config.model_copy(update={"gateway": config.gateway.model_copy(update={"mode": "listen"})})
    reader, result = SessionReader(source, frozenset({CAN_TOPIC})), Perceived()
    with output_file(target, source) as path, SessionFile(path, {}, attached=config.car.files()) as file, named(source):
        records = sorted(((unpack_frame(item.data), item.data) for item in reader.items()), key=_stamp)
        if not records:
            raise InputError(f"{source}: holds no CAN frames (topic {CAN_TOPIC})")
        session = reader.metadata.get(METADATA_SESSION, {})
        known = {"name": source.stem, "software": software(), "dbc_sha256": config.car.dbc_sha256}
        file.add_metadata(METADATA_SESSION, {**known, **session, "config": listening.model_dump_json()})
        for count, entry in enumerate(_entries(records, listening, result), start=1):
            file.add(*entry)
            if count % FLUSH_EVERY == 0:
                file.flush()
    return result


def _stamp(record: tuple[Frame, bytes]) -> int:
    return record[0].stamp_ns


def _entries(
    records: list[tuple[Frame, bytes]], config: Config, result: Perceived
) -> Iterator[tuple[str, bytes, int, int, int]]:
    """Frames as they were recorded and messages as the recorder writes them, in order of time."""
    frames = [frame for frame, _ in records]
    sent = config.car.codec.sent_by("computer")
    heard = [frame for frame in frames if frame.id not in sent]  # a gateway does not hear what it sends
    bus, link = LocalBus(), PlaybackLink(heard)
    gateway, events = Gateway(config, bus, link), EventLog(bus)
    queues = [(topic, bus.subscribe(topic, depth=256)) for topic in KEPT]
    written = 0
    for now_ns in _periods(frames):
        link.now_ns = now_ns
        while written < len(records) and frames[written].stamp_ns <= now_ns:
            frame, data = records[written]
            yield CAN_TOPIC, data, frame.stamp_ns, frame.stamp_ns, written
            written += 1
        gateway.step(now_ns)
        events.step(now_ns, gateway)
        for topic, queue in queues:
            for message in queue.poll(now_ns):
                if isinstance(message, VehicleState):
                    result.note(message)
                yield _entry(topic, message, now_ns)


def _entry(topic: Topic[Any], message: Message, now_ns: int) -> tuple[str, bytes, int, int, int]:
    return topic.key, message.model_dump_json().encode(), now_ns, message.stamp_ns, message.seq


def _periods(frames: list[Frame]) -> Iterator[int]:
    """Times of the periods from the first frame to the last, without long pauses."""
    now_ns, index = frames[0].stamp_ns, 0
    while now_ns <= frames[-1].stamp_ns + PERIOD_NS:
        yield now_ns
        now_ns += PERIOD_NS
        while index < len(frames) and frames[index].stamp_ns <= now_ns:
            index += 1
        if index < len(frames) and frames[index].stamp_ns - now_ns > LONGEST_GAP_NS:
            now_ns = frames[index].stamp_ns
