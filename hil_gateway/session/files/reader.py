"""Reads an MCAP file of any program however it ended: killed, cut at any byte, or damaged in the middle.

The file is read once, front to back, without the index at its end. Every whole chunk with a right checksum is given
out, and every message that lies between chunks, as writers without chunks leave them; what is not readable is described
in `damage`, with its place, and the reader goes on at the next chunk. What lies between the chunks, and the index at
the end, have checksums as well: they are compared when nothing else was wrong.
"""

from __future__ import annotations

import os
import struct
import zlib
from bisect import insort
from collections.abc import Callable, Iterator
from copy import copy
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Header, Metadata, Schema

from hil_gateway.bus.topics import TOPICS
from hil_gateway.can_link.cdr import CAN_SCHEMA, CAN_SCHEMA_NAME
from hil_gateway.process.arrays import Bools
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.process.errors import InputError
from hil_gateway.session.files.chunk import (
    CHUNK_BYTES_MAX,
    CHUNK_START,
    HEADER,
    INDEX_HEAD,
    MESSAGE,
    PAIR,
    Content,
    Messages,
    chunk_of,
    is_chunk,
    messages_in,
    unpacked,
)
from hil_gateway.session.files.format import CAN_TOPIC
from hil_gateway.text_file import check_ends

LIBRARY = "hil-gateway"
"""what the header of a file of ours says"""
MAGIC = b"\x89MCAP0\r\n"
_FOOTER = struct.Struct("<BQQQI8s")
"""footer record (opcode, length, two offsets, checksum of the index up to here) and the magic behind it"""
_FOOTER_CHECKED = 25
_SCAN_BYTES = 1 << 20
_SCAN_OVERLAP = 64
_TOGETHER_BYTES = 1 << 22
"""of what chunks hold that is given out together: a recording has chunks of some 10 kB"""
_KNOWN_OPCODES = {int(code) for code in Opcode}


@dataclass(frozen=True, slots=True)
class Stream:
    """One channel of a file: its topic, how its messages are encoded, and what they are.

    `kind` is the name of the schema, as `can_msgs/msg/Frame`; `definition` its text in `schema_encoding`.
    """

    topic: str
    encoding: str = ""
    kind: str = ""
    schema_encoding: str = ""
    definition: bytes = b""
    metadata: tuple[tuple[str, str], ...] = ()


NO_STREAM = Stream("")


class Item(NamedTuple):
    """One recorded message; times are Unix nanoseconds."""

    topic: str
    log_ns: int
    publish_ns: int
    sequence: int
    data: bytes
    stream: Stream = NO_STREAM


@dataclass(frozen=True)
class Damage:
    """One unreadable place."""

    offset: int
    what: str
    cut: bool = False
    """the file ends here, as one of a killed recorder does; else what was written has changed"""

    def __str__(self) -> str:
        return f"byte {self.offset}: {self.what}"


@dataclass
class SessionReader:
    """One pass over a session file. `damage`, `complete` and `metadata` are final when `items` is exhausted.

    Raises:
        InputError: no such file, or not an MCAP file (from `items`).
    """

    path: Path
    topics: frozenset[str] | None = None
    """only these are given out, which is much quicker where raw frames are not wanted; None: all"""
    kinds: frozenset[str] | None = None
    """only messages of these schemas are given out; None: all"""
    damage: list[Damage] = field(default_factory=list)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    complete: bool = False
    profile: str = ""
    """of the header: what kinds of messages the file holds, as `ros2`"""
    ours: bool = True
    """whether the file was written by this program, so far as its header says"""
    chunks: int = 0
    offset: int = 0
    """where it goes on"""
    streams: dict[int, Stream] = field(init=False)
    _schemas: dict[int, Schema] = field(default_factory=dict)
    _contents: list[Content] = field(default_factory=list)
    """that are not given out yet, so many bytes"""
    _bytes: int = 0
    _index: list[bytes] = field(default_factory=list)
    """of the newest chunk"""
    _loose: bytearray = field(default_factory=bytearray)
    """messages behind it"""
    _checksum: int = 0
    """of what is before `offset`"""

    def __post_init__(self) -> None:
        self.streams = _default_streams()

    def items(self) -> Iterator[Item]:
        """Every readable message, in file order."""
        for messages in self.batches():
            yield from self.items_of(messages, self.among(messages, self._wanted))

    def among(self, messages: Messages, wanted: Callable[[Stream], bool]) -> Bools:
        """(n,) whether a message is of a stream that is `wanted`."""
        return messages.among(lambda number: wanted(self.stream(number)))

    def items_of(self, messages: Messages, chosen: Bools) -> Iterator[Item]:
        """The `chosen` (n,) ones of `messages`."""
        data, streams = messages.data, {n: self.stream(n) for n in np.flatnonzero(messages.counts).tolist()}
        for at, size in zip(messages.at[chosen].tolist(), messages.size[chosen].tolist(), strict=True):
            channel, sequence, log_ns, publish_ns = MESSAGE.unpack_from(data, at)
            content, stream = data[at + MESSAGE.size : at + size], streams[channel]
            yield Item(stream.topic, log_ns, publish_ns, sequence, content, stream)

    def batches(self, end: int | None = None) -> Iterator[Messages]:
        """Every readable message of any topic, in file order, many at once, up to the first record that does not begin
        before `end`; what they are is in `streams`."""
        check_ends(self.path, "session")
        try:
            file = self.path.open("rb")
        except OSError as error:
            raise InputError(f"{self.path}: cannot read the session: {error.strerror}") from None
        with file:
            try:
                if file.read(len(MAGIC)) != MAGIC:
                    raise InputError(f"{self.path}: not an MCAP recording (wrong first bytes)")
                if self.offset == 0:
                    self.offset, self._checksum = len(MAGIC), zlib.crc32(MAGIC)
                file.seek(self.offset)
                size = os.fstat(file.fileno()).st_size
                yield from self._records(file, size, size if end is None else min(end, size))
            except OSError as error:
                raise InputError(f"{self.path}: cannot read the session: {error.strerror}") from None

    def chunk_behind(self, place: int) -> int | None:
        """Where the first chunk from `place` on seems to begin."""
        with self.path.open("rb") as file:
            return _next_chunk(file, place, os.fstat(file.fileno()).st_size)

    def ahead(self, begin: int) -> SessionReader:
        """A reader of what is behind `begin`, which knows what has been declared up to now."""
        names = ("streams", "_schemas", "profile", "ours")
        other = SessionReader(self.path, self.topics, self.kinds, offset=begin)
        vars(other).update((name, copy(getattr(self, name))) for name in names)
        return other

    def went_as(self, other: SessionReader) -> bool:
        """Whether what `ahead` gave out before this one came there is what it would give out now."""
        return self.ahead(self.offset) == other

    def go_on_behind(self, other: SessionReader) -> bool:
        """Be where a reader is that began here; not behind damage, which is told by the number of its chunk."""
        if other.damage:
            return False
        with self.path.open("rb") as file:
            file.seek(self.offset)
            self._checksum = zlib.crc32(file.read(other.offset - self.offset), self._checksum)
        self.offset, self.streams, self._schemas = other.offset, other.streams, other._schemas
        self.chunks += other.chunks
        self.metadata |= other.metadata
        return True

    def _records(self, file: BinaryIO, size: int, end: int) -> Iterator[Messages]:
        while self.offset < end:
            head = file.read(HEADER.size)
            opcode, length = HEADER.unpack(head.ljust(HEADER.size, b"\0"))
            offset, behind = self.offset, self.offset + HEADER.size + length
            readable = opcode in _KNOWN_OPCODES and behind <= size
            whole = opcode != Opcode.MESSAGE_INDEX and self._bytes + len(self._loose) > _TOGETHER_BYTES
            if not readable or whole or opcode == Opcode.DATA_END:
                yield from self._gathered()
            if len(head) < HEADER.size:
                self._note(offset, f"cut off {len(head)} bytes into a record", cut=True)
                self.offset = size
                return
            if not readable:
                self.offset = self._resume(file, offset, size)
                continue
            body = file.read(length)
            if opcode == Opcode.DATA_END:
                self._check(offset, "what lies between the chunks", _expected(body), self._checksum)
                self._read_index(file, offset)
                self.offset = size
                return
            self._checksum = zlib.crc32(body, zlib.crc32(head, self._checksum))
            self._read(opcode, head, body, offset)
            if opcode == Opcode.FOOTER:
                self.complete = file.read() == MAGIC
                self._note(offset, "the record that ends the messages is corrupt")
            self.offset = behind
        yield from self._gathered()

    def _read(self, opcode: int, head: bytes, body: bytes, offset: int) -> None:
        """Take a record in; messages are kept for `_gathered`."""
        if opcode == Opcode.CHUNK:
            self._chunk(body, offset)
        elif opcode == Opcode.MESSAGE_INDEX:
            self._index.append(body[INDEX_HEAD:] if (len(body) - INDEX_HEAD) % PAIR == 0 else b"")
        elif opcode == Opcode.MESSAGE and len(body) >= MESSAGE.size:
            self._loose += head + body
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
            self._between_chunks(opcode, body, offset)
        elif opcode == Opcode.METADATA:
            self._read_metadata(body, offset)
        elif opcode == Opcode.HEADER:
            self._read_header(body)

    def _gathered(self) -> Iterator[Messages]:
        """What has been read and not given out."""
        self._end_loose()
        contents, self._contents, self._bytes = self._contents, [], 0
        messages = messages_in(contents, self._declare)
        if len(messages):
            yield messages
        for at, fault in messages.faults.items():
            self._note(contents[at].offset, f"chunk {contents[at].number}{contents[at].span} is corrupt: {fault}")

    def _end_loose(self) -> None:
        """What is between chunks ends here."""
        if self._loose:
            self._take(Content(bytes(self._loose)))
            self._loose.clear()

    def _take(self, content: Content) -> None:
        self._contents.append(content)
        self._bytes += len(content.data)

    def _read_index(self, file: BinaryIO, offset: int) -> None:
        """The end of a file that was closed in order: its index, footer and magic."""
        index = file.read()
        tail = index[-_FOOTER.size :]
        self.complete = index.endswith(MAGIC)
        if len(tail) < _FOOTER.size or tail[0] != Opcode.FOOTER or not self.complete:
            self._note(offset, "cut off: every message is there, the index is not", cut=not self.complete)
            return
        expected: int = _FOOTER.unpack(tail)[4]
        checked = index[: len(index) - _FOOTER.size + _FOOTER_CHECKED]
        self._check(offset, "the index", expected, zlib.crc32(checked))

    def _check(self, offset: int, what: str, expected: int, found: int) -> None:
        """Note a wrong checksum; 0 is none, and where something else was wrong it has to be."""
        if expected not in (0, found) and not self.damage:
            self._note(offset, f"{what} is corrupt: its checksum is wrong; every message is whole")

    def _between_chunks(self, opcode: int, body: bytes, offset: int) -> None:
        try:
            self._declare(opcode, body)
        except (McapError, ValueError, struct.error) as error:
            self._note(offset, f"a record between the chunks is corrupt: {error}")

    def _chunk(self, body: bytes, offset: int) -> None:
        self._end_loose()
        number, self.chunks, self._index, span = self.chunks, self.chunks + 1, [], _span(body)
        try:
            chunk = chunk_of(body)
            if chunk.uncompressed_size > CHUNK_BYTES_MAX:
                self._note(offset, f"chunk {number}{span} claims {chunk.uncompressed_size} bytes: not read")
                return
            # a checksum, where there is one, says that its messages are whole
            self._take(Content(unpacked(chunk), self._index, number, offset, span))
        except Exception as error:  # whatever a decompressor raises, the chunk is damaged
            self._note(offset, f"chunk {number}{span} is corrupt: {type(error).__name__}: {error}")

    def _declare(self, opcode: int, body: bytes) -> None:
        """Keep a schema or a channel.

        Raises:
            McapError, ValueError, struct.error: it is corrupt.
        """
        if opcode == Opcode.CHANNEL:
            self._add_stream(Channel.read(ReadDataStream(BytesIO(body))))
        elif opcode == Opcode.SCHEMA:
            schema = Schema.read(ReadDataStream(BytesIO(body)))
            self._schemas[schema.id] = schema
        elif opcode == Opcode.MESSAGE:
            raise ValueError("a message is shorter than what is in front of its content")

    def _wanted(self, stream: Stream) -> bool:
        right_topic = self.topics is None or stream.topic in self.topics
        return right_topic and (self.kinds is None or stream.kind in self.kinds)

    def _add_stream(self, channel: Channel) -> None:
        schema = self._schemas.get(channel.schema_id) or Schema(0, b"", "", "")
        self.streams[channel.id] = Stream(
            channel.topic, channel.message_encoding, schema.name, schema.encoding, schema.data,
            tuple(channel.metadata.items()),
        )  # fmt: skip

    def stream(self, channel: int) -> Stream:
        """The channel of this number."""
        return self.streams.setdefault(channel, Stream(f"channel {channel}"))

    def _read_header(self, body: bytes) -> None:
        try:
            header = Header.read(ReadDataStream(BytesIO(body)))
        except (McapError, ValueError, struct.error):
            return  # the checksum of what lies between the chunks says so
        self.profile, self.ours = header.profile, header.library.startswith(LIBRARY)
        if not self.ours:
            self.streams.clear()

    def _read_metadata(self, body: bytes, offset: int) -> None:
        try:
            record = Metadata.read(ReadDataStream(BytesIO(body)))
        except (McapError, ValueError, struct.error) as error:
            self._note(offset, f"metadata is corrupt: {error}")
        else:
            self.metadata[record.name] = record.metadata

    def _resume(self, file: BinaryIO, offset: int, size: int) -> int:
        """Position `file` at the next recognisable chunk after `offset`, and say where that is; `size` when there is
        none."""
        if (found := _next_chunk(file, offset + 1, size)) is None:
            self._note(offset, f"cut off: the last {size - offset} bytes are no whole record", cut=True)
            return size
        self._note(offset, f"{found - offset} unreadable bytes")
        return file.seek(found)

    def _note(self, offset: int, what: str, cut: bool = False) -> None:
        insort(self.damage, Damage(offset, what, cut), key=lambda damage: damage.offset)


def _next_chunk(file: BinaryIO, start: int, size: int) -> int | None:
    """Where the first recognisable chunk from `start` on begins, that ends within `size`."""
    while start < size:
        file.seek(start)
        window = file.read(_SCAN_BYTES)
        for found in CHUNK_START.finditer(window):
            position = start + found.start()
            length = HEADER.unpack_from(window, found.start())[1]
            if position + HEADER.size + length <= size and is_chunk(window, found):
                return position
        start += max(len(window) - _SCAN_OVERLAP, 1)
    return None


def _default_streams() -> dict[int, Stream]:
    """Channel numbers as our writer gives them out, for a file whose first chunk is damaged."""
    frames = Stream(CAN_TOPIC, "cdr", CAN_SCHEMA_NAME, "ros2msg", CAN_SCHEMA.encode())
    topics = (Stream(topic.key, "json", topic.message.__name__, "jsonschema") for topic in TOPICS if topic.recorded)
    return dict(enumerate((frames, *topics), start=1))


def _expected(data_end: bytes) -> int:
    """Checksum of everything before the record `DataEnd`; 0 where there is none."""
    return int.from_bytes(data_end[:4], "little")


def _span(body: bytes) -> str:
    """Times of a chunk, in words, from its own (perhaps damaged) header."""
    if len(body) < 16:
        return ""
    start, end = struct.unpack_from("<QQ", body)
    return f" ({start / NS_PER_S:.3f} s to {end / NS_PER_S:.3f} s)"
