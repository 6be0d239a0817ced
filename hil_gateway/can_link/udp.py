"""CAN over UDP multicast on the loopback interface, for computers without SocketCAN.

The datagrams are those of python-can's `udp_multicast` (a msgpack map of fields of `can.Message`), so its programs
can follow. The socket is ours: python-can joins the group on the interface of the default route, so it fails
without a network and hears other computers with one. Our own datagrams always have the same layout, read by one
`struct` call; `channel` names the sender, so that own frames are left out, and `timestamp` (which every receiver
replaces by its own) numbers them, so that gaps are counted as lost.
"""

from __future__ import annotations

import os
import socket
from struct import Struct
from typing import Any

from can_dbc.database import DLC_MAX
from hil_gateway.can_link.base import EXTENDED_ID, Frame, SocketLink, prepare

_IP_MULTICAST_ALL = 49
_LOOPBACK = "127.0.0.1"
SENDERS_REMEMBERED = 64
"""Bound of the table of sequence numbers."""

# msgpack: map of 5; fixed-width unsigned 32 and 64 bit; strings of 14, 7, 9 and 4 bytes; then the data with its length
_MAP_ID = b"\x85\xaearbitration_id\xce"
_CHANNEL = b"\xaeis_extended_id\xc2\xa7channel\xac"
_EXTENDED_CHANNEL = _CHANNEL.replace(b"\xc2", b"\xc3", 1)
_LARGEST = {_CHANNEL: socket.CAN_SFF_MASK, _EXTENDED_CHANNEL: socket.CAN_EFF_MASK}
"""whether it is an extended one -> largest identifier"""
_SEQUENCE = b"\xa9timestamp\xcf"
_DATA = b"\xa4data\xc4"
_HEADER = Struct(f">{len(_MAP_ID)}sI{len(_CHANNEL)}s12s{len(_SEQUENCE)}sQ{len(_DATA)}sB")


class UdpLink(SocketLink):
    """One member of a multicast group on this computer."""

    kind = "udp_multicast"

    def __init__(self, group: str, port: int) -> None:
        self._group, self._port = group, port
        self._sender = os.urandom(6).hex().encode()
        self._sequence = 0
        self._next: dict[bytes, int] = {}
        super().__init__()

    def _open(self) -> socket.socket:
        source = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            source.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            source.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
            source.bind((self._group, self._port))
            loopback = socket.inet_aton(_LOOPBACK)
            source.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(self._group) + loopback)
            source.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, loopback)
            source.setsockopt(socket.IPPROTO_IP, _IP_MULTICAST_ALL, 0)  # nothing from other interfaces
            return prepare(source)
        except OSError:
            source.close()
            raise

    def _parse(self, payload: bytes, stamp_ns: int) -> Frame | None:
        if len(payload) < _HEADER.size:
            return self._parse_foreign(payload, stamp_ns)
        id_key, frame_id, channel, sender, sequence_key, sequence, data_key, length = _HEADER.unpack_from(payload)
        data = payload[_HEADER.size :]
        ours = id_key == _MAP_ID and sequence_key == _SEQUENCE and data_key == _DATA
        if not ours or len(data) != length or length > DLC_MAX or frame_id > _LARGEST.get(channel, -1):
            return self._parse_foreign(payload, stamp_ns)
        if sender == self._sender:
            return None
        if sequence != self._next.get(sender):
            self._count_gap(sender, sequence)
        self._next[sender] = sequence + 1
        return Frame(frame_id if channel == _CHANNEL else frame_id | EXTENDED_ID, data, stamp_ns)

    def _parse_foreign(self, payload: bytes, stamp_ns: int) -> Frame | None:
        """A datagram of python-can itself, or of anybody: anything can be sent to an open port."""
        import msgpack

        try:
            frame = _classic_frame(msgpack.unpackb(payload), stamp_ns)
        except (ValueError, TypeError, KeyError, AttributeError, IndexError, msgpack.UnpackException):
            self.counts.malformed += 1
            return None
        self.counts.error_frames += frame.is_error
        return frame

    def _pack(self, frame_id: int, data: bytes) -> bytes:
        sequence, self._sequence = self._sequence, self._sequence + 1
        channel = _EXTENDED_CHANNEL if frame_id & EXTENDED_ID else _CHANNEL
        number = frame_id & ~EXTENDED_ID
        header = (_MAP_ID, number, channel, self._sender, _SEQUENCE, sequence, _DATA, len(data))
        return _HEADER.pack(*header) + data

    def _transmit(self, target: socket.socket, payload: bytes) -> None:
        target.sendto(payload, (self._group, self._port))

    def _count_gap(self, sender: bytes, sequence: int) -> None:
        """Datagrams that never came from a sender received before."""
        expected = self._next.get(sender)
        if expected is None:
            if len(self._next) >= SENDERS_REMEMBERED:
                del self._next[next(iter(self._next))]
        elif sequence > expected:
            self.counts.lost += sequence - expected

    def _count_drops(self, kernel_total: int) -> None:
        """Already counted by sequence number."""


def _classic_frame(fields: dict[str, Any], stamp_ns: int) -> Frame:
    """A frame from the fields of a `can.Message`; ValueError or what comes of it when it is none."""
    frame_id, data = fields["arbitration_id"], fields["data"]
    if not 0 <= frame_id <= socket.CAN_EFF_MASK or not isinstance(data, bytes) or len(data) > DLC_MAX:
        raise ValueError("not a classic frame")
    if fields.get("is_remote_frame") or fields.get("is_fd"):
        raise ValueError("not a data frame")
    extended = EXTENDED_ID if fields.get("is_extended_id") else 0
    return Frame(int(frame_id) | extended, data, stamp_ns, bool(fields.get("is_error_frame")))
