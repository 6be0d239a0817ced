"""Reads an MCAP file of any program however it ended: killed, cut at any byte, or damaged in the middle.

The file is read once, front to back, without its index. Every whole chunk with a right checksum is given out, and
every message that lies between chunks, as writers without chunks leave them; what is not readable is described in
`damage`, with its place, and the reader goes on at the next chunk. What lies between the chunks, and the index at the
end, have checksums as well: they are compared when nothing else was wrong.
"""

from __future__ import annotations

import os
import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Header, Metadata, Schema

from hil_gateway.bus.topics import TOPICS
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.process.errors import InputError
from hil_gateway.session.files.format import CAN_SCHEMA, CAN_SCHEMA_NAME, CAN_TOPIC
from hil_gateway.text_file import check_ends

LIBRARY = "hil-gateway"
"""what the header of a file of ours says"""
MAGIC = b"\x89MCAP0\r\n"
_HEADER = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_FOOTER = struct.Struct("<BQQQI8s")
"""footer record (opcode, length, two offsets, checksum of the index up to here) and the magic behind it"""
_FOOTER_CHECKED = 25
# start, end, uncompressed size, CRC, length and name of the compression: what makes a chunk recognisable
_CHUNK_START = re.compile(rb"\x06.{8}.{28}(?:\x04\x00\x00\x00zstd|\x03\x00\x00\x00lz4|\x00\x00\x00\x00)", re.DOTALL)
_PLAIN_CHUNK = struct.Struct("<BQ8x8xQ4xIQ")
"""of a chunk without compression: its length, the size of its content twice, and no name say that it is one"""
_PLAIN_CHUNK_HEAD = 40
CHUNK_BYTES_MAX = 1 << 26
"""of a chunk's content: ours have 1 MB, other writers' some; more is a mistake, or meant to fill the memory"""
_CONTENT = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE)
_SCAN_BYTES = 1 << 20
_SCAN_OVERLAP = 64
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
    streams: dict[int, Stream] = field(init=False)
    _schemas: dict[int, Schema] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.streams = _default_streams()

    def items(self) -> Iterator[Item]:
        """Every readable message, in file order."""
        check_ends(self.path, "session")
        try:
            file = self.path.open("rb")
        except OSError as error:
            raise InputError(f"{self.path}: cannot read the session: {error.strerror}") from None
        with file:
            try:
                if file.read(len(MAGIC)) != MAGIC:
                    raise InputError(f"{self.path}: not an MCAP recording (wrong first bytes)")
                yield from self._records(file, os.fstat(file.fileno()).st_size)
            except OSError as error:
                raise InputError(f"{self.path}: cannot read the session: {error.strerror}") from None

    def _records(self, file: BinaryIO, size: int) -> Iterator[Item]:
        checksum = zlib.crc32(MAGIC)
        while (offset := file.tell()) < size:
            head = file.read(_HEADER.size)
            if len(head) < _HEADER.size:
                self._note(offset, f"cut off {len(head)} bytes into a record", cut=True)
                return
            opcode, length = _HEADER.unpack(head)
            if opcode not in _KNOWN_OPCODES or offset + _HEADER.size + length > size:
                if not self._resume(file, offset, size):
                    return
                continue
            body = file.read(length)
            if opcode == Opcode.DATA_END:
                self._check(offset, "what lies between the chunks", _expected(body), checksum)
                self._read_index(file, offset)
                return
            checksum = zlib.crc32(body, zlib.crc32(head, checksum))
            if opcode == Opcode.CHUNK:
                yield from self._chunk(body, offset)
            elif opcode in _CONTENT:
                yield from self._between_chunks(opcode, body, offset)
            elif opcode == Opcode.METADATA:
                self._read_metadata(body, offset)
            elif opcode == Opcode.HEADER:
                self._read_header(body)
            elif opcode == Opcode.FOOTER:
                self.complete = file.read() == MAGIC
                self._note(offset, "the record that ends the messages is corrupt")

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

    def _between_chunks(self, opcode: int, body: bytes, offset: int) -> Iterator[Item]:
        try:
            if item := self._record(opcode, body, 0, len(body)):
                yield item
        except (McapError, ValueError, struct.error) as error:
            self._note(offset, f"a record between the chunks is corrupt: {error}")

    def _chunk(self, body: bytes, offset: int) -> Iterator[Item]:
        number, self.chunks = self.chunks, self.chunks + 1
        try:
            chunk = Chunk.read(ReadDataStream(BytesIO(body)))
            if chunk.uncompressed_size > CHUNK_BYTES_MAX:
                self._note(offset, f"chunk {number}{_span(body)} claims {chunk.uncompressed_size} bytes: not read")
                return
            data = _unpacked(chunk)
        except Exception as error:  # whatever a decompressor raises, the chunk is damaged
            self._note(offset, f"chunk {number}{_span(body)} is corrupt: {type(error).__name__}: {error}")
            return
        try:
            yield from self._messages(data)
        except (McapError, ValueError, struct.error) as error:
            self._note(offset, f"chunk {number}{_span(body)} is corrupt: {error}")

    def _messages(self, data: bytes) -> Iterator[Item]:
        """Messages of a chunk; a checksum, where there is one, has said already that they are whole."""
        position = 0
        while position < len(data):
            opcode, size = _HEADER.unpack_from(data, position)
            position += _HEADER.size
            if position + size > len(data):
                raise ValueError("a record is longer than the chunk")
            if item := self._record(opcode, data, position, size):
                yield item
            position += size

    def _record(self, opcode: int, data: bytes, position: int, size: int) -> Item | None:
        """The message of one record, if it is one that is wanted; schemas and channels are kept."""
        if opcode == Opcode.MESSAGE:
            channel, sequence, log_ns, publish_ns = _MESSAGE.unpack_from(data, position)
            stream = self.streams.get(channel) or self._unknown(channel)
            if self._wanted(stream):
                content = data[position + _MESSAGE.size : position + size]
                return Item(stream.topic, log_ns, publish_ns, sequence, content, stream)
        elif opcode == Opcode.CHANNEL:
            self._add_stream(Channel.read(ReadDataStream(BytesIO(data[position : position + size]))))
        elif opcode == Opcode.SCHEMA:
            schema = Schema.read(ReadDataStream(BytesIO(data[position : position + size])))
            self._schemas[schema.id] = schema
        return None

    def _wanted(self, stream: Stream) -> bool:
        right_topic = self.topics is None or stream.topic in self.topics
        return right_topic and (self.kinds is None or stream.kind in self.kinds)

    def _add_stream(self, channel: Channel) -> None:
        schema = self._schemas.get(channel.schema_id) or Schema(0, b"", "", "")
        self.streams[channel.id] = Stream(
            channel.topic, channel.message_encoding, schema.name, schema.encoding, schema.data,
            tuple(channel.metadata.items()),
        )  # fmt: skip

    def _unknown(self, channel: int) -> Stream:
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

    def _resume(self, file: BinaryIO, offset: int, size: int) -> bool:
        """Position `file` at the next recognisable chunk after `offset`; False when there is none."""
        start = offset + 1
        while start < size:
            file.seek(start)
            window = file.read(_SCAN_BYTES)
            for found in _CHUNK_START.finditer(window):
                position = start + found.start()
                length = _HEADER.unpack_from(window, found.start())[1]
                if position + _HEADER.size + length <= size and _is_chunk(window, found):
                    self._note(offset, f"{position - offset} unreadable bytes")
                    file.seek(position)
                    return True
            start += max(len(window) - _SCAN_OVERLAP, 1)
        self._note(offset, f"cut off: the last {size - offset} bytes are no whole record", cut=True)
        return False

    def _note(self, offset: int, what: str, cut: bool = False) -> None:
        self.damage.append(Damage(offset, what, cut))


def _unpacked(chunk: Chunk) -> bytes:
    """Content of a chunk; what unpacks to another size than it claims is corrupt before all of it is in memory.

    Raises:
        ValueError: another size, an unknown compression; and whatever a decompressor raises.
    """
    limit = chunk.uncompressed_size + 1
    if chunk.compression == "zstd":
        data = zstandard.ZstdDecompressor().stream_reader(chunk.data, read_across_frames=True).read(limit)
    elif chunk.compression == "lz4":
        data = lz4.frame.LZ4FrameFile(BytesIO(chunk.data)).read(limit)
    elif not chunk.compression:
        data = chunk.data[:limit]
    else:
        raise ValueError(f"compression {chunk.compression[:20]!r} is not known")
    if len(data) != chunk.uncompressed_size:
        raise ValueError(f"unpacks to another size than the {chunk.uncompressed_size} bytes it claims")
    if chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        raise ValueError("its checksum is wrong")
    return bytes(data)


def _is_chunk(window: bytes, found: re.Match[bytes]) -> bool:
    """Whether a place that looks like the start of a chunk is one: without compression its lengths must agree."""
    if found.group().endswith((b"zstd", b"lz4")):
        return True
    if found.start() + _PLAIN_CHUNK.size > len(window):
        return False
    _, length, content, no_name, again = _PLAIN_CHUNK.unpack_from(window, found.start())
    return bool(no_name == 0 and content == again and length == content + _PLAIN_CHUNK_HEAD)


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
