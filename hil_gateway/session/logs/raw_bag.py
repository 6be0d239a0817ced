"""Messages of a bag as they were written: MCAP or SQLite, one file or a folder of parts, compressed or not.

Read here and not through rosbags, whose reader refuses a file that was cut off and a folder without its metadata.
"""

from __future__ import annotations

import re
import sqlite3
import tempfile
from collections.abc import Collection, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.records import Header

from hil_gateway.process.errors import InputError
from hil_gateway.session.files.reader import LIBRARY, MAGIC, Item, SessionReader, Stream
from hil_gateway.session.logs.source import DAMAGED, Source

SQLITE = b"SQLite format 3\0"
ZSTD = b"\x28\xb5\x2f\xfd"
"""first bytes of a message that was compressed by itself; one in CDR begins with a zero"""
ROS2_PROFILE = "ros2"
_HEADER = b"\x01"
"""opcode of the record an MCAP file begins with"""
MESSAGE_BYTES_MAX = 1 << 28
_COPY_BYTES = 1 << 20


def is_mcap(source: Source) -> bool:
    """By the first bytes."""
    return source.head.startswith(MAGIC)


def is_sqlite(source: Source) -> bool:
    """By the first bytes."""
    return source.head.startswith(SQLITE)


def is_recording(source: Source) -> bool:
    """Whether an MCAP file is of this program, and no bag that it exported; one without a header counts as such."""
    head = source.head[len(MAGIC) :]
    if not is_mcap(source) or not head.startswith(_HEADER):
        return is_mcap(source)
    length = int.from_bytes(head[1:9], "little")
    header = Header.read(ReadDataStream(BytesIO(head[9 : 9 + length])))
    return bool(header.library.startswith(LIBRARY)) and header.profile != ROS2_PROFILE


def bag_files(path: Path) -> list[Path]:
    """The files of a bag in the order they were written: those of a folder, or the file itself.

    Raises:
        InputError: a folder without any.
    """
    if not path.is_dir():
        return [path]
    files = [f for f in path.iterdir() if f.is_file() and re.search(r"\.(?:mcap|db3)(?:\.zstd|\.zst)?$", f.name)]
    if not files:
        raise InputError(f"{path}: a folder without a bag: no .mcap or .db3 in it")
    return sorted(files, key=lambda f: [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", f.name)])


@dataclass
class Bag:
    """One pass over a bag; `damage` is final when `items` is exhausted.

    Raises:
        InputError: no such file, or no bag (from `items`).
    """

    path: Path
    topics: Collection[str] | None = None
    kinds: Collection[str] | None = None
    """only messages of these topics and of these types are given out; None: all"""
    damage: list[str] = field(default_factory=list)
    streams: dict[str, Stream] = field(default_factory=dict)
    """topic -> what is known of it, of all that the files name"""
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)

    def items(self) -> Iterator[Item]:
        """Every readable message that is wanted, file by file."""
        for file in bag_files(self.path):
            with unpacked(Source(file)) as (plain, cut):
                yield from self._mcap(plain) if is_mcap(Source(plain)) else self._sqlite(file, plain)
            if cut:
                self.damage.append(f"{file.name}: the compressed file is cut off")

    def _mcap(self, plain: Path) -> Iterator[Item]:
        topics = None if self.topics is None else frozenset(self.topics)
        kinds = None if self.kinds is None else frozenset(self.kinds)
        reader = SessionReader(plain, topics, kinds)
        yield from reader.items()
        self.streams |= {stream.topic: stream for stream in reader.streams.values()}
        self.metadata |= reader.metadata
        self.damage += [str(damage) for damage in reader.damage]

    def _sqlite(self, file: Path, plain: Path) -> Iterator[Item]:
        try:
            with closing(sqlite3.connect(f"{plain.resolve().as_uri()}?mode=ro&immutable=1", uri=True)) as database:
                streams = _streams(database)
                self.streams |= {stream.topic: stream for stream in streams.values()}
                yield from self._rows(database, {n: s for n, s in streams.items() if self._wanted(s)})
        except sqlite3.Error as error:
            if not self.streams:
                raise InputError(f"{file}: not a bag: {error}") from None
            self.damage.append(f"{file.name}: {error}: read as far as it goes")

    def _wanted(self, stream: Stream) -> bool:
        right_topic = self.topics is None or stream.topic in self.topics
        return right_topic and (self.kinds is None or stream.kind in self.kinds)

    def _rows(self, database: sqlite3.Connection, wanted: dict[int, Stream]) -> Iterator[Item]:
        marks = ",".join("?" * len(wanted))
        rows = database.execute(
            f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({marks}) ORDER BY id", [*wanted]
        )
        for number, (topic, stamp_ns, data) in enumerate(rows, start=1):
            yield Item(wanted[topic].topic, stamp_ns, stamp_ns, number, _message(data), wanted[topic])


def _streams(database: sqlite3.Connection) -> dict[int, Stream]:
    """Topic number -> stream; definitions are there since ROS 2 Iron."""
    tables = {name for (name,) in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    known: dict[str, tuple[str, bytes]] = {}
    if "message_definitions" in tables:
        rows = database.execute("SELECT topic_type, encoding, encoded_message_definition FROM message_definitions")
        known = {kind: (encoding, text.encode() if isinstance(text, str) else text) for kind, encoding, text in rows}
    topics = database.execute("SELECT id, name, type, serialization_format FROM topics")
    return {n: Stream(name, encoding, kind, *known.get(kind, ("", b""))) for n, name, kind, encoding in topics}


def _message(data: bytes) -> bytes:
    """The message itself where it was compressed by itself."""
    if not data.startswith(ZSTD):
        return data
    return zstandard.ZstdDecompressor().decompress(data, max_output_size=MESSAGE_BYTES_MAX)


@contextmanager
def unpacked(source: Source) -> Iterator[tuple[Path, bool]]:
    """The file itself, or a copy of what it packs, and whether that was cut off."""
    if not source.packed:
        yield source.path, False
        return
    cut = False
    with tempfile.TemporaryDirectory(prefix="hil-") as folder:
        plain = Path(folder) / source.path.with_suffix("").name
        with source.open() as packed, plain.open("wb") as out:
            try:
                while part := packed.read(_COPY_BYTES):
                    out.write(part)
            except DAMAGED:
                cut = True
        yield plain, cut
