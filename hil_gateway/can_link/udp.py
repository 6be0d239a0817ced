"""CAN over UDP multicast on the loopback interface, for computers without SocketCAN.

The datagrams are python-can's `udp_multicast` format. The socket is ours: python-can joins the group on the
interface of the default route, so it fails without a network and hears other computers with one. Every
datagram's `channel` field carries sender and sequence number: own frames are left out, gaps are counted as lost.
"""

from __future__ import annotations

import os
import socket
import struct

from hil_gateway.can_link.base import EXTENDED_ID, Frame, SocketLink, prepare

_IP_MULTICAST_ALL = 49
_LOOPBACK = "127.0.0.1"
SENDERS_REMEMBERED = 64
"""Bound of the table of sequence numbers."""


class UdpLink(SocketLink):
    """One member of a multicast group on this computer."""

    kind = "udp_multicast"

    def __init__(self, group: str, port: int) -> None:
        from can import Message
        from can.interfaces.udp_multicast.utils import pack_message, unpack_message

        self._group, self._port = group, port
        self._message, self._pack_message, self._unpack_message = Message, pack_message, unpack_message
        self._name = f"hil-{os.getpid()}-{os.urandom(4).hex()}"
        self._own_mark = self._name.encode()
        self._sequence = 0
        self._next: dict[str, int] = {}
        super().__init__()

    def _open(self) -> socket.socket:
        source = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            source.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            source.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
            source.bind((self._group, self._port))
            loopback = socket.inet_aton(_LOOPBACK)
            membership = struct.pack("4s4s", socket.inet_aton(self._group), loopback)
            source.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
            source.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, loopback)
            source.setsockopt(socket.IPPROTO_IP, _IP_MULTICAST_ALL, 0)  # nothing from other interfaces
            return prepare(source)
        except OSError:
            source.close()
            raise

    def _parse(self, payload: bytes, stamp_ns: int) -> Frame | None:
        if self._own_mark in payload:
            return None
        try:
            message = self._unpack_message(payload, check=True)
            frame_id, data = int(message.arbitration_id), bytes(message.data)
        except Exception:  # anything can be sent to an open port; python-can names no narrower type
            self.counts.malformed += 1
            return None
        if message.is_remote_frame or message.is_fd:
            self.counts.malformed += 1
            return None
        sender, _, sequence = str(message.channel).partition("/")
        self._count_gap(sender, sequence)
        frame_id |= EXTENDED_ID if message.is_extended_id else 0
        self.counts.error_frames += message.is_error_frame
        return Frame(frame_id, data, stamp_ns, bool(message.is_error_frame))

    def _pack(self, frame_id: int, data: bytes) -> bytes:
        channel = f"{self._name}/{self._sequence}"
        self._sequence += 1
        packed: bytes = self._pack_message(
            self._message(arbitration_id=frame_id, data=data, is_extended_id=False, channel=channel)
        )
        return packed

    def _transmit(self, target: socket.socket, payload: bytes) -> None:
        target.sendto(payload, (self._group, self._port))

    def _count_gap(self, sender: str, sequence: str) -> None:
        """Datagrams that never came; a sender of another kind numbers nothing and is not counted."""
        if not sequence.isdecimal():
            return
        number = int(sequence)
        if sender not in self._next and len(self._next) >= SENDERS_REMEMBERED:
            self._next.pop(next(iter(self._next)))
        expected = self._next.get(sender, number)
        if number > expected:
            self.counts.lost += number - expected
        self._next[sender] = max(expected, number + 1)

    def _count_drops(self, kernel_total: int) -> None:
        """Already counted by sequence number."""
