"""Raw frames of a ROS 2 bag, and of a recording of ours: `can_msgs/msg/Frame` on whatever topic."""

from __future__ import annotations

import re
from collections.abc import Iterator

from hil_gateway.can_link import EXTENDED_ID, Frame
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.session.files.format import MessageError, frame_fields
from hil_gateway.session.files.reader import Item
from hil_gateway.session.logs.entry import REMOTE_REQUEST, Entry, LeftOut, LoggedFrame
from hil_gateway.session.logs.raw_bag import Bag
from hil_gateway.session.logs.source import Source

KINDS = frozenset({"can_msgs/msg/Frame", "can_msgs/Frame"})
UNREADABLE = LeftOut("message that is no can_msgs/msg/Frame")
_DIRECTION = re.compile(r"/?(?:(?:from|to)_can_bus|can_[rt]x)$")
"""how drivers name what they receive from a bus and what they send to it: two topics of one bus"""
_SOURCE = re.compile(r"(.+)/[rt]x")
"""`header.frame_id` of ours: bus and direction"""


def read_bag(source: Source) -> Iterator[Entry]:
    """Frames of a bag, stamped by the driver, or by the recorder where the driver did not."""
    bag = Bag(source.path, kinds=KINDS)
    for item in bag.items():
        yield _entry(item)
    source.notes += bag.damage


def _entry(item: Item) -> Entry:
    try:
        seconds, nanoseconds, frame_id, number, remote, extended, is_error, data = frame_fields(
            item.data, ros1=item.stream.encoding == "ros1"
        )
    except MessageError:
        return UNREADABLE
    if remote:
        return REMOTE_REQUEST
    stamp_ns = seconds * NS_PER_S + nanoseconds or item.log_ns
    frame = Frame(number | EXTENDED_ID if extended else number, data, stamp_ns, is_error)
    return LoggedFrame(_bus(item.topic, frame_id), frame)


def _bus(topic: str, frame_id: str) -> str:
    """Name of the bus a frame was on."""
    if ours := _SOURCE.fullmatch(frame_id):
        return ours[1]
    return _DIRECTION.sub("", topic).strip("/") or frame_id or "can0"
