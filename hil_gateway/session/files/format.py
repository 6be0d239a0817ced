"""What a session file holds: channels, schemas, metadata, and the CDR form of a raw CAN frame.

Raw frames are `can_msgs/msg/Frame` in CDR with its ros2msg definition, so that common tools read them; topics are
the JSON that went over the bus, with the JSON schema of their Pydantic model.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import struct
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

from pydantic import ValidationError

from can_dbc.database import DBC_PATH
from hil_gateway.bus.messages import Message
from hil_gateway.bus.topics import Topic
from hil_gateway.can_link import EXTENDED_ID, Frame
from hil_gateway.config import Config
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.process.errors import InputError

M = TypeVar("M", bound=Message)

CAN_TOPIC = "av24/can"
CAN_SCHEMA_NAME = "can_msgs/msg/Frame"
CAN_SCHEMA = """std_msgs/Header header
uint32 id
bool is_rtr
bool is_extended
bool is_error
uint8 dlc
uint8[8] data
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
METADATA_SESSION = "session"
METADATA_REVISION = "model_revision"

_CDR_LITTLE_ENDIAN = b"\x00\x01\x00\x00"
# encapsulation, stamp (sec, nanosec), frame_id "" (length 1 with its NUL, padded to 4), id, four single bytes, data
_FRAME = struct.Struct("<4siII4xI???B8s")


class MessageError(InputError):
    """A recorded message this version cannot read."""


@contextmanager
def named(path: Path) -> Iterator[None]:
    """Say which file an unreadable message is in."""
    try:
        yield
    except MessageError as error:
        raise InputError(f"{path}: {error}") from None


def pack_frame(frame: Frame, unix_ns: int) -> bytes:
    """CDR of one classic CAN frame stamped `unix_ns`."""
    seconds, nanoseconds = divmod(unix_ns, NS_PER_S)
    extended = not frame.is_error and bool(frame.id & EXTENDED_ID)
    number = frame.id & ~EXTENDED_ID
    flags = (False, extended, frame.is_error)  # remote requests never become a Frame
    return _FRAME.pack(_CDR_LITTLE_ENDIAN, seconds, nanoseconds, 1, number, *flags, len(frame.data), frame.data)


def unpack_frame(cdr: bytes) -> Frame:
    """Inverse of `pack_frame`; the stamp is Unix time.

    Raises:
        MessageError: not a frame written by this project (another frame_id, another length).
    """
    if len(cdr) != _FRAME.size:
        raise MessageError(f"{CAN_TOPIC}: a record of {len(cdr)} bytes, not {_FRAME.size}: recorded by another program")
    _, seconds, nanoseconds, _, number, _, extended, is_error, dlc, data = _FRAME.unpack(cdr)
    stamp_ns = seconds * NS_PER_S + nanoseconds
    return Frame(number | EXTENDED_ID if extended else number, data[:dlc], stamp_ns, is_error)


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
        "dbc_sha256": dbc_hash(),
        "config": config.model_dump_json(),
    }


def dbc_hash() -> str:
    """SHA-256 of the DBC in use."""
    return hashlib.sha256(DBC_PATH.read_bytes()).hexdigest()


def software_version() -> str:
    """Version of the project, with the commit when it runs from a checkout."""
    version = importlib.metadata.version("hil-gateway")
    root = DBC_PATH.parent.parent
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
