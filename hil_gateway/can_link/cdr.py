"""A CAN frame as `can_msgs/msg/Frame` in CDR: in recordings and to ROS."""

from __future__ import annotations

import struct
from functools import cache

from hil_gateway.can_link import EXTENDED_ID, Frame
from hil_gateway.process.clock import NS_PER_S

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
SOURCE_MAX = 255
"""longest `header.frame_id` that is read, bytes"""
_CDR_LITTLE_ENDIAN = b"\x00\x01\x00\x00"


@cache
def frame_layout(source_bytes: int, order: str = "<") -> struct.Struct:
    """CDR of a frame whose `frame_id` has this many bytes (NUL and padding to 4 follow), id, flags, dlc, data."""
    return struct.Struct(f"{order}4siII{source_bytes // 4 * 4 + 4}sI???B8s")


def pack_frame(frame: Frame, unix_ns: int, source: str = "") -> bytes:
    """CDR of one classic CAN frame stamped `unix_ns`; `source` as `frame_source` says it, where it is known."""
    seconds, nanoseconds = divmod(unix_ns, NS_PER_S)
    extended = not frame.is_error and bool(frame.id & EXTENDED_ID)
    number, where = frame.id & ~EXTENDED_ID, source.encode("ascii", "replace")[:SOURCE_MAX]
    flags = (False, extended, frame.is_error)  # remote requests never become a Frame
    head = (_CDR_LITTLE_ENDIAN, seconds, nanoseconds, len(where) + 1, where)
    return frame_layout(len(where)).pack(*head, number, *flags, len(frame.data), frame.data)
