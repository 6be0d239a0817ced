"""The recorder: hears everything, says nothing but how it is doing; losing it changes nothing elsewhere."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Any

from hil_gateway.bus.interface import Bus, Subscription
from hil_gateway.bus.messages import ModelRevision, RecorderStatus
from hil_gateway.bus.topics import RECORDER_STATUS, TOPICS, Topic
from hil_gateway.bus.track_day.note import Note
from hil_gateway.can_link import CanLink
from hil_gateway.can_link.cdr import pack_frame
from hil_gateway.config import RecorderConfig
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.session.files.format import CAN_TOPIC, METADATA_REVISION, frame_source
from hil_gateway.session.files.writer import SessionWriter

QUEUE_S = 2.0
"""how long the recorder may be held up before messages are lost (and counted)"""


class Recorder:
    """Writes raw frames of `link` and all recorded topics of `bus`.

    `unix_offset_ns` is added to monotonic stamps: recordings carry Unix time. `channel` is the name of the interface,
    `sent` the identifiers of what the computer sends.
    """

    def __init__(
        self, config: RecorderConfig, bus: Bus, link: CanLink, writer: SessionWriter, unix_offset_ns: int,
        *, sent: Collection[int], channel: str = "",
    ) -> None:  # fmt: skip
        self._bus, self._link, self.writer, self._offset_ns = bus, link, writer, unix_offset_ns
        self._wire, self._sent = channel or link.kind, sent
        self._flush_ns = int(config.flush_s * NS_PER_S)
        self._subscriptions: list[tuple[Topic[Any], Subscription[Any]]] = [
            (topic, bus.subscribe(topic, depth=max(int(QUEUE_S * topic.rate_hz), 16)))
            for topic in TOPICS
            if topic.recorded
        ]
        self._next_flush_ns = 0
        self._next_status_ns = 0
        self._frames = 0
        self._status_seq = 0
        self._revision, self._noted = "", 0

    def step(self, now_ns: int) -> None:
        """Take in everything that has arrived, and flush when it is time."""
        self._record_topics(now_ns)
        self._record_frames(now_ns)
        if now_ns >= self._next_flush_ns:
            self._next_flush_ns = now_ns + self._flush_ns
            self.writer.flush(now_ns + self._offset_ns)
        if now_ns >= self._next_status_ns:
            self._next_status_ns = now_ns + RECORDER_STATUS.period_ns
            self._bus.publish(RECORDER_STATUS, self.status(now_ns))

    def close(self, now_ns: int) -> None:
        """Record what is still queued and end the file."""
        self._record_topics(now_ns)
        self._record_frames(now_ns)
        self.writer.close(now_ns + self._offset_ns)

    def status(self, now_ns: int) -> RecorderStatus:
        """Health of the recording; messages lost on the way to the recorder count as lost."""
        self._status_seq += 1
        dropped = sum(subscription.dropped for _, subscription in self._subscriptions)
        writer = self.writer
        return RecorderStatus(
            stamp_ns=now_ns,
            seq=self._status_seq,
            file=writer.path.name,
            recording=writer.recording,
            frames=writer.written.frames,
            messages=writer.written.messages,
            lost=writer.lost + dropped + self._link.stats().lost,
            errors=writer.errors,
            last_error=writer.last_error,
            bytes_written=writer.bytes_written,
            free_bytes=writer.free_bytes,
            noted=self._noted,
        )

    def _record_topics(self, now_ns: int) -> None:
        log_ns = now_ns + self._offset_ns
        for topic, subscription in self._subscriptions:
            for message in subscription.poll(now_ns):
                data = message.model_dump_json().encode()
                self.writer.add(topic.key, data, log_ns, message.stamp_ns + self._offset_ns, message.seq)
                if isinstance(message, Note) and self.writer.recording:
                    self._noted = message.seq
                if isinstance(message, ModelRevision) and message.revision != self._revision:
                    self._note_revision(message)

    def _note_revision(self, message: ModelRevision) -> None:
        self._revision = message.revision
        values = {"revision": message.revision, "layout": message.layout, "note": message.provenance.note}
        self.writer.add_metadata(METADATA_REVISION, values)

    def _record_frames(self, now_ns: int) -> None:
        log_ns = now_ns + self._offset_ns
        for frame in self._link.receive(0.0):
            stamp_ns = frame.stamp_ns + self._offset_ns
            data = pack_frame(frame, stamp_ns, frame_source(self._wire, frame.id, self._sent))
            self.writer.add(CAN_TOPIC, data, log_ns, stamp_ns, self._frames)
            self._frames += 1


def session_path(config: RecorderConfig, started: str) -> Path:
    """File of a new session: `recorder.name` in `recorder.folder`, or named by its start."""
    return Path(config.folder) / f"{config.name or started.replace(':', '')}.mcap"
