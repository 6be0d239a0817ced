"""Writes sessions: one MCAP file at a time, flushed often, rotated, guarded against a full disk.

A disk that fails costs data, never the process: whatever could not be written is counted in `lost`, the error is
kept in words, the file is cut back to its last whole chunk, and a new file is tried every `RETRY_S`.
"""

from __future__ import annotations

import contextlib
import logging
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from mcap.writer import Writer
from typing_extensions import Buffer

from hil_gateway.bus.topics import TOPICS
from hil_gateway.can_link.cdr import CAN_SCHEMA, CAN_SCHEMA_NAME
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.process.writable import free_bytes, short_of_space
from hil_gateway.session.files.format import CAN_TOPIC, METADATA_SESSION, json_schema
from hil_gateway.session.files.reader import LIBRARY, Stream

log = logging.getLogger(__name__)

RETRY_S = 1.0
PENDING_LIMIT = 4 * 2**20
"""a flush is forced at this many bytes, so that memory stays bounded"""

FLUSH_EVERY = 5000
"""messages in a chunk of a file that is made of another one"""
FILE_MODE = 0o644
Write = Callable[[int, Buffer], int]
"""os.write, or a test's version of it"""


class Sink:
    """Byte sink below the MCAP writer: nothing reaches the disk before `flush`, and then all or nothing.

    The file is always a new one: two recorders of one name never write into each other's.
    """

    def __init__(self, path: Path, write: Write = os.write) -> None:
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, FILE_MODE)
        self._write = write
        self._pending = bytearray()
        self.size = 0

    def write(self, data: bytes) -> int:
        """Keep `data` for the next flush."""
        self._pending += data
        return len(data)

    def tell(self) -> int:
        """Offset the next byte will have."""
        return self.size + len(self._pending)

    def flush(self) -> None:
        """Write what is kept.

        Raises:
            OSError: the disk refused; the file ends where it ended before the call.
        """
        view, done = memoryview(bytes(self._pending)), 0
        self._pending.clear()
        try:
            while done < len(view):
                done += self._write(self._fd, view[done:])
        except OSError:
            os.ftruncate(self._fd, self.size)
            raise
        self.size += done

    def close(self) -> None:
        """Close the file; nothing is written. Closing twice is harmless, and so is a disk that fails once more."""
        fd, self._fd = self._fd, -1
        if fd >= 0:
            with contextlib.suppress(OSError):
                os.close(fd)


class SessionFile:
    """One MCAP file with a channel for raw frames, one for every recorded topic, and one for each `further` one.

    `attached`: name and text of the files of the car, which decode the frames, the DBC first. `further`: topic -> name
    and text of its JSON schema. `foreign`: profile of a file of another program, that gets its own channels alone.
    """

    def __init__(
        self, path: Path, metadata: Mapping[str, dict[str, str]], write: Write = os.write,
        *, attached: Mapping[str, str] | None = None, further: Mapping[str, tuple[str, bytes]] | None = None,
        foreign: str | None = None,
    ) -> None:  # fmt: skip
        self.path = path
        self.sink = Sink(path, write)
        try:
            self._writer = Writer(self.sink, chunk_size=2 * PENDING_LIMIT, enable_data_crcs=True)
            self._writer.start(profile=foreign or "", library=LIBRARY)
            self._schemas: dict[tuple[str, bytes], int] = {}
            self._channels = self._register(further or {}) if foreign is None else {}
            for name, text in (attached or {}).items():
                self._writer.add_attachment(0, 0, name, "text/plain", text.encode())
            for name, values in metadata.items():
                self._writer.add_metadata(name, values)
            self.sink.flush()
        except OSError:
            self.sink.close()
            path.unlink(missing_ok=True)  # nothing is in it
            raise

    def _register(self, further: Mapping[str, tuple[str, bytes]]) -> dict[str, int]:
        frame = self._writer.register_schema(CAN_SCHEMA_NAME, "ros2msg", CAN_SCHEMA.encode())
        channels = {CAN_TOPIC: self._writer.register_channel(CAN_TOPIC, "cdr", frame)}
        ours = {topic.key: (topic.message.__name__, json_schema(topic.message)) for topic in TOPICS if topic.recorded}
        for topic, (name, text) in {**ours, **further}.items():
            schema = self._writer.register_schema(name, "jsonschema", text)
            channels[topic] = self._writer.register_channel(topic, "json", schema)
        return channels

    def __enter__(self) -> Self:
        return self

    def __exit__(self, failed: type[BaseException] | None, *_: object) -> None:
        if failed:
            self.sink.close()
        else:
            self.finish()

    def open(self, stream: Stream) -> None:
        """Have a channel for the messages of `stream`, as its own file describes them."""
        if stream.topic in self._channels:
            return
        key, schema = (stream.kind, stream.definition), 0
        if stream.kind:
            schema = self._schemas.get(key) or self._writer.register_schema(
                stream.kind, stream.schema_encoding, stream.definition
            )
            self._schemas[key] = schema
        self._channels[stream.topic] = self._writer.register_channel(
            stream.topic, stream.encoding, schema, dict(stream.metadata)
        )

    def add(self, topic: str, data: bytes, log_ns: int, publish_ns: int, sequence: int) -> None:
        """Add one message to the chunk in progress; times are Unix nanoseconds."""
        self._writer.add_message(self._channels[topic], log_ns, data, publish_ns, sequence % 2**32)

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Add a metadata record (written with the next flush)."""
        self._writer.add_metadata(name, values)

    def flush(self) -> None:
        """End the chunk in progress and hand everything to the operating system."""
        self._writer.flush()

    def finish(self) -> None:
        """Write the index and close."""
        try:
            self._writer.finish()
            self.sink.flush()
        finally:
            self.sink.close()


@dataclass
class Counts:
    """Numbers of raw frames and of topic messages."""

    frames: int = 0
    messages: int = 0

    @property
    def total(self) -> int:
        """Both."""
        return self.frames + self.messages


class SessionWriter:
    """A session across rotation, disk errors and lack of space; no method raises OSError. Times are Unix ns."""

    def __init__(
        self, path: Path, metadata: dict[str, str], rotate_bytes: int, min_free_bytes: int = 0,
        write: Write = os.write, *, attached: Mapping[str, str] | None = None,
    ) -> None:  # fmt: skip
        """`attached`: see `SessionFile`."""
        self._attached = attached
        self._first, self._write = path, write
        self._rotate_bytes, self._min_free_bytes = rotate_bytes, min_free_bytes
        self._metadata = {METADATA_SESSION: metadata}
        self._file: SessionFile | None = None
        self._opened = 0
        self._retry_ns = 0
        self._finished_bytes = 0
        self._pending = Counts()
        self._pending_bytes = 0
        self.written = Counts()
        """what reached the operating system"""
        self.lost = 0
        self.errors = 0
        self.last_error = ""
        self.free_bytes: int | None = None
        self._short_of_space = False
        self.flush(0)

    @property
    def path(self) -> Path:
        """File being written, or the last one."""
        return self._file.path if self._file else self._path(max(self._opened - 1, 0))

    @property
    def recording(self) -> bool:
        """Whether a file is open."""
        return self._file is not None

    @property
    def bytes_written(self) -> int:
        """Bytes on disk, over all files."""
        return self._finished_bytes + (self._file.sink.size if self._file else 0)

    def add(self, topic: str, data: bytes, log_ns: int, publish_ns: int, sequence: int) -> None:
        """Record one message, or count it lost."""
        if self._file is None:
            self.lost += 1
            return
        self._file.add(topic, data, log_ns, publish_ns, sequence)
        if topic == CAN_TOPIC:
            self._pending.frames += 1
        else:
            self._pending.messages += 1
        self._pending_bytes += len(data)
        if self._pending_bytes > PENDING_LIMIT:
            self.flush(log_ns)

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Add a metadata record to the file in progress; files that follow begin with the newest of each name."""
        self._metadata[name] = values
        if self._file is not None:
            self._file.add_metadata(name, values)

    def flush(self, now_ns: int) -> None:
        """Hand everything to the operating system; then see to rotation, space and a file that has to be reopened."""
        if self._file is not None:
            self._attempt(self._file.flush, now_ns)
        if self._file is not None and self._file.sink.size >= self._rotate_bytes:
            self._finish(now_ns)
        enough = self._enough_space()
        if not enough and not self._short_of_space:  # also where no file has been begun: said once, not every flush
            self._fail(short_of_space(self.free_bytes or 0, self._min_free_bytes))
        self._short_of_space = not enough
        if self._file is not None and not enough:
            self._finish(now_ns)
        elif self._file is None and enough and now_ns >= self._retry_ns:
            self._attempt(self._open, now_ns)

    def close(self, now_ns: int) -> None:
        """End the session with a readable file."""
        self._finish(now_ns)

    def _open(self) -> None:
        self._first.parent.mkdir(parents=True, exist_ok=True)
        while self._file is None:
            part, self._opened = self._opened, self._opened + 1
            metadata = dict(self._metadata)
            metadata[METADATA_SESSION] = {**metadata[METADATA_SESSION], "part": str(part)}
            with contextlib.suppress(FileExistsError):  # of a recorder that was killed, or of another one: left alone
                self._file = SessionFile(self._path(part), metadata, self._write, attached=self._attached)

    def _path(self, part: int) -> Path:
        return self._first if part == 0 else self._first.with_stem(f"{self._first.stem}_{part:03d}")

    def _finish(self, now_ns: int) -> None:
        if self._file is not None and self._attempt(self._file.finish, now_ns):
            self._finished_bytes += self._file.sink.size
            self._file = None

    def _attempt(self, action: Callable[[], None], now_ns: int) -> bool:
        """Run one disk operation; a failure counts what was pending as lost and gives the file up."""
        pending, self._pending, self._pending_bytes = self._pending, Counts(), 0
        try:
            action()
        except OSError as error:
            self._fail(f"{self.path.name}: {error.strerror or error}")
            self.lost += pending.total
            self._give_up(now_ns)
            return False
        self.written.frames += pending.frames
        self.written.messages += pending.messages
        return True

    def _fail(self, text: str) -> None:
        self.errors += 1
        if text != self.last_error:  # tried again every second: said once
            log.warning("not recording in %s: %s", self._first.parent, text)
        self.last_error = text

    def _give_up(self, now_ns: int) -> None:
        if self._file is not None:
            self._finished_bytes += self._file.sink.size
            self._file.sink.close()
            self._file = None
        self._retry_ns = now_ns + int(RETRY_S * NS_PER_S)

    def _enough_space(self) -> bool:
        if self._min_free_bytes == 0:
            return True
        try:
            self.free_bytes = free_bytes(self._first.parent)
        except OSError:
            self.free_bytes = None
            return True  # the write itself will tell
        return self.free_bytes >= self._min_free_bytes
