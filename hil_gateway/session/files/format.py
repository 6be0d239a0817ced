"""What a session file holds: channels, schemas, metadata, and the CDR form of a raw CAN frame.

Raw frames are `can_msgs/msg/Frame` in CDR with its ros2msg definition, so that common tools read them; topics are
the JSON that went over the bus, with the JSON schema of their Pydantic model.
"""

from __future__ import annotations

import importlib.metadata
import json
import struct
import subprocess
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple, TypeVar

from pydantic import ValidationError

from can_dbc.folder import SHIPPED
from hil_gateway.bus.messages import Message
from hil_gateway.bus.topics import Topic
from hil_gateway.can_link import EXTENDED_ID, Frame
from hil_gateway.can_link.cdr import CAN_SCHEMA_NAME, SOURCE_MAX, frame_layout
from hil_gateway.config import Config
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.process.errors import InputError

M = TypeVar("M", bound=Message)

CAN_TOPIC = "av24/can"
METADATA_SESSION = "session"
METADATA_REVISION = "model_revision"

_ROS1_TAIL = struct.Struct("<I???B8s")
_ENCAPSULATION, _SOURCE_AT = 4, 12
"""after the encapsulation and the stamp (sec, nanosec)"""


class MessageError(InputError):
    """A recorded message this version cannot read."""


@contextmanager
def named(path: Path) -> Iterator[None]:
    """Say which file an unreadable message is in."""
    try:
        yield
    except MessageError as error:
        raise InputError(f"{path}: {error}") from None


def frame_source(bus: str, frame_id: int, sent: Collection[int]) -> str:
    """`header.frame_id` of a recorded frame: bus and direction; `tx` where the computer sends it."""
    return f"{bus}/{'tx' if frame_id in sent else 'rx'}"


def unpack_frame(cdr: bytes) -> Frame:
    """Inverse of `pack_frame`; the stamp is Unix time.

    Raises:
        MessageError: no frame in CDR of this layout.
    """
    seconds, nanoseconds, _, number, _, extended, is_error, data = frame_fields(cdr)
    stamp_ns = seconds * NS_PER_S + nanoseconds
    return Frame(number | EXTENDED_ID if extended else number, data, stamp_ns, is_error)


def recorded_source(cdr: bytes) -> str:
    """What `pack_frame` was told of where the frame came from; empty where nothing.

    Raises:
        MessageError: as `unpack_frame`.
    """
    length = _checked_layout(cdr)[0]
    return _text(cdr[_SOURCE_AT + 4 : _SOURCE_AT + 4 + length])


def source_places(cdr: bytes) -> tuple[tuple[int, int], ...]:
    """Place and length of the pieces that `recorded_source` depends on: frames of one size that agree in them have one
    source."""
    try:
        length = _checked_layout(cdr)[0]
    except MessageError:
        length = 0
    pieces = (0, _ENCAPSULATION), (_SOURCE_AT, 4 + length)
    return tuple((at, size) for at, size in pieces if at + size <= len(cdr))


class FrameFields(NamedTuple):
    """`can_msgs/msg/Frame` field by field."""

    seconds: int
    nanoseconds: int
    frame_id: str
    number: int
    is_remote: bool
    is_extended: bool
    is_error: bool
    data: bytes


def frame_fields(cdr: bytes, *, ros1: bool = False) -> FrameFields:
    """What any program's `can_msgs/msg/Frame` says, in CDR of either byte order or as ROS 1 writes it.

    Raises:
        MessageError: no such message.
    """
    if ros1:
        return _ros1_fields(cdr)
    layout = _checked_layout(cdr)[1]
    _, seconds, nanoseconds, _, source, number, remote, extended, error, dlc, data = layout.unpack_from(cdr)
    return FrameFields(seconds, nanoseconds, _text(source), number, remote, extended, error, data[:dlc])


def _checked_layout(cdr: bytes) -> tuple[int, struct.Struct]:
    """Length of the source with its final zero, and where the fields are."""
    order = ">" if len(cdr) > 1 and not cdr[1] & 1 else "<"
    length = int.from_bytes(cdr[_SOURCE_AT : _SOURCE_AT + 4], "big" if order == ">" else "little")
    layout = frame_layout(length - 1, order) if 1 <= length <= SOURCE_MAX + 1 else None
    if layout is None or not layout.size <= len(cdr) < layout.size + 4:  # some writers pad the end
        raise _no_frame(cdr)
    return length, layout


def _ros1_fields(data: bytes) -> FrameFields:
    """Without padding, and with a sequence number before the stamp."""
    head = struct.Struct("<IiII")
    if len(data) < head.size or len(data) != head.size + (length := head.unpack_from(data)[3]) + _ROS1_TAIL.size:
        raise _no_frame(data)
    _, seconds, nanoseconds, _ = head.unpack_from(data)
    number, remote, extended, error, dlc, content = _ROS1_TAIL.unpack_from(data, head.size + length)
    source = _text(data[head.size : head.size + length])
    return FrameFields(seconds, nanoseconds, source, number, remote, extended, error, content[:dlc])


@lru_cache(maxsize=64)
def _text(source: bytes) -> str:
    return source.rstrip(b"\0").decode("ascii", "replace")


def _no_frame(data: bytes) -> MessageError:
    return MessageError(
        f"{CAN_TOPIC}: a record of {len(data)} bytes that is no {CAN_SCHEMA_NAME}: recorded by another program"
    )


def unpack_message(topic: Topic[M], data: bytes) -> M:
    """Message of a topic as it was recorded.

    Raises:
        MessageError: not one of this version.
    """
    try:
        return topic.message.model_validate_json(data)
    except ValidationError as error:
        raise MessageError(f"{topic}: a message this version cannot read: {error.errors()[0]['msg'].lower()}") from None


def session_metadata(config: Config, name: str, bus: str, started: str) -> dict[str, str]:
    """What identifies a session; every value is text, as MCAP metadata demands."""
    return {
        "name": name,
        "started": started,
        "bus": bus,
        "channel": config.can.channel if bus == "socketcan" else "",
        "software": software_version(),
        "dbc_sha256": config.car.dbc_sha256,
        "config": config.model_dump_json(),
    }


def software_version() -> str:
    """Version of the project, with the commit when it runs from a checkout."""
    version = importlib.metadata.version("hil-gateway")
    root = SHIPPED.parent
    if not (root / ".git").exists():
        return version
    command = ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=12"]
    try:
        commit = subprocess.run(command, capture_output=True, text=True, timeout=2, check=True).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return version
    return f"{version}+{commit}"


def json_schema(message: type) -> bytes:
    """JSON schema of a message type, as stored in the file."""
    schema: dict[str, object] = message.model_json_schema()  # type: ignore[attr-defined]
    return json.dumps(schema).encode()
