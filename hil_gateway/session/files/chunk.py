"""The messages of chunks, found all at once by the index that follows each.

The index only says where to look: what it leaves out is read record by record, and one that is wrong is not used.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from io import BytesIO

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import numpy.typing as npt
import zstandard
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Chunk

from hil_gateway.process.arrays import Bools, Ints

HEADER = struct.Struct("<BQ")
"""of every record: opcode and length"""
MESSAGE = struct.Struct("<HIQQ")
"""before a message's content: channel, sequence, log and publish time"""
CHUNK_BYTES_MAX = 1 << 26
"""of a chunk's content: ours have 1 MB, other writers' some; more is a mistake, or meant to fill the memory"""
# start, end, uncompressed size, CRC, length and name of the compression: what makes a chunk recognisable
CHUNK_START = re.compile(rb"\x06.{8}.{28}(?:\x04\x00\x00\x00zstd|\x03\x00\x00\x00lz4|\x00\x00\x00\x00)", re.DOTALL)
_PLAIN_CHUNK = struct.Struct("<BQ8x8xQ4xIQ")
"""of a chunk without compression: its length, the size of its content twice, and no name say that it is one"""
_PLAIN_CHUNK_HEAD = 40
INDEX_HEAD, PAIR = 6, 16
"""bytes of an index's channel and length, before its pairs of time and place, and of each of these"""
_CHUNK, _LENGTH = struct.Struct("<QQQII"), struct.Struct("<Q")
"""of a chunk: start, end, size and checksum of its content, length of the compression's name; behind that, of `data`"""

_HEAD = np.dtype([
    ("opcode", "u1"), ("size", "<i8"), ("channel", "<u2"), ("sequence", "<u4"), ("log_ns", "<i8"), ("publish_ns", "<i8")
])  # fmt: skip
"""both together"""
Heads = npt.NDArray[np.void]
OtherRecord = Callable[[int, bytes], object]
"""takes opcode and body of a record that is no message"""


@dataclass(frozen=True)
class Content:
    """What one chunk unpacks to; `index`: the pairs of the index records behind it; `number` and `offset` of the chunk
    in the file, `span` of its times in words."""

    data: bytes
    index: Sequence[bytes] = ()
    number: int = 0
    offset: int = 0
    span: str = ""


@dataclass(frozen=True)
class Messages:
    """Messages in `data`, in its order, (n,) each: where they begin and how long they are, both without the record's
    header, their channel, log and publish time, Unix ns. `faults`: place of a content -> why there are no more of it,
    in words."""

    data: bytes
    at: Ints
    size: Ints
    channel: Ints
    log_ns: Ints
    publish_ns: Ints
    faults: Mapping[int, str]

    def __len__(self) -> int:
        """How many."""
        return len(self.at)

    @cached_property
    def counts(self) -> Ints:
        """How many of each channel, by its number."""
        return np.asarray(np.bincount(self.channel))

    def among(self, wanted: Callable[[int], bool]) -> Bools:
        """(n,) whether a message is of a channel whose number is `wanted`."""
        table = np.array([count > 0 and wanted(number) for number, count in enumerate(self.counts.tolist())], bool)
        return np.asarray(table[self.channel])

    def pieces(self, at: Ints, length: int) -> Heads:
        """`length` bytes behind places `at` (m,), (m,); they compare as a whole."""
        return _every(self.data, np.dtype((np.void, length)))[at]


def messages_in(contents: Sequence[Content], other: OtherRecord) -> Messages:
    """The messages of several chunks in one array: what is done at once for many is quick for small chunks as well."""
    data = b"".join(content.data for content in contents)
    bounds = np.cumsum([0, *(len(content.data) for content in contents)])
    starts, heads = _indexed(data, bounds, contents)
    begins, ends = np.sort(np.append(bounds[:-1], _ends(starts, heads))), np.sort(np.append(bounds[1:], starts))
    found, faults = list[int](), dict[int, str]()
    for gap in np.flatnonzero(begins < ends):
        inside = int(np.searchsorted(bounds, begins[gap], "right")) - 1
        try:
            for start in _walk(data, int(begins[gap]), int(ends[gap]), int(bounds[inside + 1]), other):
                found.append(start)
        except (McapError, ValueError, struct.error) as error:
            faults.setdefault(inside, str(error))
    if found:
        starts = np.sort(np.append(starts, np.array(found, np.int64)))
        heads = _every(data, _HEAD)[starts]
    return Messages(
        data, starts + HEADER.size, heads["size"], heads["channel"].astype(np.int64), heads["log_ns"],
        heads["publish_ns"], faults,
    )  # fmt: skip


def _indexed(data: bytes, bounds: Ints, contents: Sequence[Content]) -> tuple[Ints, Heads]:
    """Where messages begin by their index, in order, and their heads; none of a content whose index has a place that is
    not a message of its own."""
    pairs = [b"".join(content.index) for content in contents]
    places, counts = np.frombuffer(b"".join(pairs), "<i8")[1::2], [len(of_one) // PAIR for of_one in pairs]
    inside = np.repeat(np.arange(len(contents)), counts)
    within = (places >= 0) & (places <= np.diff(bounds)[inside] - _HEAD.itemsize)
    right = np.ones(len(contents), bool)
    right[inside[~within]] = False
    starts, inside = np.sort((places + bounds[inside])[within]), inside[within]
    heads = _every(data, _HEAD)[starts]
    ends = _ends(starts, heads)
    messages = (heads["opcode"] == Opcode.MESSAGE) & (heads["size"] >= MESSAGE.size)
    apart = np.minimum(np.append(starts[1:], len(data)), bounds[inside + 1]) >= ends
    right[inside[~(messages & apart)]] = False
    return starts[right[inside]], heads[right[inside]]


def _every(data: bytes, dtype: np.dtype[np.void]) -> Heads:
    """`data` read as `dtype` from each of its bytes on."""
    return np.ndarray((max(len(data) - dtype.itemsize + 1, 0),), dtype, data, strides=(1,))


def _ends(starts: Ints, heads: Heads) -> Ints:
    return np.asarray(starts + heads["size"] + HEADER.size)


def _walk(data: bytes, position: int, end: int, limit: int, other: OtherRecord) -> Iterator[int]:
    """Record by record, in a content that ends at `limit`: where messages begin.

    Raises:
        ValueError, struct.error: a record that cannot be.
    """
    while position < end:
        opcode, size = HEADER.unpack_from(data, position)
        content = position + HEADER.size
        if content + size > limit:
            raise ValueError("a record is longer than the chunk")
        if opcode != Opcode.MESSAGE:
            other(opcode, data[content : content + size])
        elif size < MESSAGE.size:
            raise ValueError("a message is shorter than what is in front of its content")
        else:
            yield position
        position = content + size


def chunk_of(body: bytes) -> Chunk:
    """A chunk's record; read field by field, as the library does, it takes as long as to unpack it.

    Raises:
        ValueError, struct.error: it is cut off.
    """
    start, end, size, checksum, length = _CHUNK.unpack_from(body)
    begin = _CHUNK.size + length + _LENGTH.size
    name = body[_CHUNK.size : _CHUNK.size + length].decode()
    packed = body[begin : begin + _LENGTH.unpack_from(body, begin - _LENGTH.size)[0]]
    return Chunk(name, packed, end, start, checksum, size)


def unpacked(chunk: Chunk) -> bytes:
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


def is_chunk(window: bytes, found: re.Match[bytes]) -> bool:
    """Whether a place that looks like the start of a chunk is one: without compression its lengths must agree."""
    if found.group().endswith((b"zstd", b"lz4")):
        return True
    if found.start() + _PLAIN_CHUNK.size > len(window):
        return False
    _, length, content, no_name, again = _PLAIN_CHUNK.unpack_from(window, found.start())
    return bool(no_name == 0 and content == again and length == content + _PLAIN_CHUNK_HEAD)
