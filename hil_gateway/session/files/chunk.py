"""The messages of a chunk, found all at once by the index that follows it.

The index only says where to look: what it leaves out is read record by record, and one that is wrong is not used.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from io import BytesIO

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import numpy.typing as npt
import zstandard
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Chunk

from hil_gateway.process.arrays import Ints

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
_INDEX = struct.Struct("<HI")
"""before an index's pairs of time and place: channel, length in bytes"""

_HEAD = np.dtype([
    ("opcode", "u1"), ("size", "<i8"), ("channel", "<u2"), ("sequence", "<u4"), ("log_ns", "<i8"), ("publish_ns", "<i8")
])  # fmt: skip
"""both together"""
_NONE = np.zeros(0, np.int64)
Heads = npt.NDArray[np.void]
OtherRecord = Callable[[int, bytes], object]
"""takes opcode and body of a record that is no message"""


@dataclass(frozen=True)
class Messages:
    """Messages in `data`, in its order, (n,) each: where they begin and how long they are, both without the record's
    header, their channel and log time, Unix ns. `fault`: why there are no more of them, in words, or empty."""

    data: bytes
    at: Ints
    size: Ints
    channel: Ints
    log_ns: Ints
    fault: str = ""

    def __len__(self) -> int:
        """How many."""
        return len(self.at)

    def rows(self, at: Ints, columns: Ints) -> npt.NDArray[np.uint8]:
        """Bytes at `columns` (k,) behind places `at` (m,), (m, k)."""
        return np.asarray(np.frombuffer(self.data, np.uint8)[at[:, None] + columns])


def messages_in(data: bytes, index: Sequence[bytes], other: OtherRecord) -> Messages:
    """The messages of a chunk's content; `index`: bodies of the index records behind it."""
    starts, heads = _indexed(data, index)
    begins, ends, found, fault = [0, *_ends(starts, heads)], [*starts.tolist(), len(data)], list[int](), ""
    try:
        for begin, end in zip(begins, ends, strict=True):
            if begin < end:
                _walk(data, begin, end, found, other)
    except (McapError, ValueError, struct.error) as error:
        fault = str(error)
    if found:
        starts = np.sort(np.append(starts, np.array(found, np.int64)))
        heads = _heads(data, starts)
    return Messages(
        data, starts + HEADER.size, heads["size"], heads["channel"].astype(np.int64), heads["log_ns"], fault
    )  # fmt: skip


def _indexed(data: bytes, index: Sequence[bytes]) -> tuple[Ints, Heads]:
    """Where messages begin by their index, in order, and their heads; none where one of the places is not a message of
    its own."""
    pairs = [np.frombuffer(body, "<i8", offset=_INDEX.size) for body in index if (len(body) - _INDEX.size) % 16 == 0]
    starts = np.sort(np.concatenate([_NONE, *(pair[1::2] for pair in pairs)]))
    if not len(starts) or starts[0] < 0 or starts[-1] > len(data) - _HEAD.itemsize:
        return _NONE, _heads(data, _NONE)
    heads = _heads(data, starts)
    ends = starts + heads["size"] + HEADER.size
    messages = (heads["opcode"] == Opcode.MESSAGE) & (heads["size"] >= MESSAGE.size)
    apart = np.append(starts[1:], len(data)) >= ends
    return (starts, heads) if np.all(messages & apart) else (_NONE, heads[:0])


def _heads(data: bytes, starts: Ints) -> Heads:
    """Of records that begin at `starts` (n,), (n,)."""
    rows = np.frombuffer(data, np.uint8)[starts[:, None] + np.arange(_HEAD.itemsize)]
    return np.asarray(rows.reshape(-1).view(_HEAD))


def _ends(starts: Ints, heads: Heads) -> list[int]:
    return list((starts + heads["size"] + HEADER.size).tolist())


def _walk(data: bytes, position: int, end: int, found: list[int], other: OtherRecord) -> None:
    """Record by record: where messages begin goes to `found`.

    Raises:
        ValueError, struct.error: a record that cannot be.
    """
    while position < end:
        opcode, size = HEADER.unpack_from(data, position)
        content = position + HEADER.size
        if content + size > len(data):
            raise ValueError("a record is longer than the chunk")
        if opcode != Opcode.MESSAGE:
            other(opcode, data[content : content + size])
        elif size < MESSAGE.size:
            raise ValueError("a message is shorter than what is in front of its content")
        else:
            found.append(position)
        position = content + size


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
