"""SocketCAN: python-can opens and configures the raw socket, frames are read from it directly.

Reading through python-can costs several times as much (benchmarks/gateway.py) and hides the kernel's drop
counter. Commands are sent one by one and never with `send_periodic`: that would transmit from inside the
kernel and go on after this process hangs.
"""

from __future__ import annotations

import logging
import socket
import struct
from pathlib import Path

from hil_gateway.can_link.base import EXTENDED_ID, BusState, Frame, SocketLink, prepare

_FRAME = struct.Struct("=IB3x8s")  # struct can_frame of <linux/can.h>
_IFF_UP = 1

# <linux/can/error.h>: class bits of the identifier, then bits of data[1] for controller problems
_ERR_CONTROLLER, _ERR_BUS_OFF, _ERR_RESTARTED = 0x04, 0x40, 0x100
_WARNING, _PASSIVE, _ACTIVE = 0x04 | 0x08, 0x10 | 0x20, 0x40


class SocketCanLink(SocketLink):
    """One SocketCAN interface, real or vcan."""

    kind = "socketcan"

    def __init__(self, channel: str) -> None:
        self._channel = channel
        super().__init__()
        if not self._is_up():
            self.counts.bus_state = BusState.DOWN

    def _open(self) -> socket.socket:
        from can.interfaces.socketcan import SocketcanBus

        logging.getLogger("can").setLevel(logging.CRITICAL)  # it logs what it also raises
        bus = SocketcanBus(channel=self._channel)
        source: socket.socket = bus.socket.dup()
        bus.shutdown()
        return prepare(source)

    def _is_up(self) -> bool:
        try:
            return bool(int(Path(f"/sys/class/net/{self._channel}/flags").read_text(), 16) & _IFF_UP)
        except (OSError, ValueError):
            return False

    def _parse(self, payload: bytes, stamp_ns: int) -> Frame | None:
        flagged_id, length, data = _FRAME.unpack(payload)
        if flagged_id <= socket.CAN_SFF_MASK:
            return Frame(flagged_id, data[:length], stamp_ns)
        if flagged_id & socket.CAN_ERR_FLAG:
            self._count_error(flagged_id, data)
            return Frame(flagged_id & socket.CAN_ERR_MASK, data[:length], stamp_ns, is_error=True)
        if flagged_id & socket.CAN_RTR_FLAG:
            self.counts.malformed += 1
            return None
        return Frame(flagged_id & socket.CAN_EFF_MASK | EXTENDED_ID, data[:length], stamp_ns)

    def _pack(self, frame_id: int, data: bytes) -> bytes:
        return _FRAME.pack(frame_id, len(data), data)

    def _transmit(self, target: socket.socket, payload: bytes) -> None:
        target.send(payload)

    def _count_error(self, error_class: int, data: bytes) -> None:
        self.counts.error_frames += 1
        state = state_after_error(error_class, data)
        if state is not None:
            self.counts.bus_state = state


def state_after_error(error_class: int, data: bytes) -> BusState | None:
    """Bus state an error frame announces; None where it tells of a single error only.

    `error_class`: identifier with the class bits of <linux/can/error.h>; `data`: its 8 bytes.
    """
    if error_class & _ERR_BUS_OFF:
        return BusState.BUS_OFF
    if error_class & _ERR_RESTARTED:
        return BusState.ERROR_ACTIVE
    if error_class & _ERR_CONTROLLER:
        for bits, state in (
            (_PASSIVE, BusState.ERROR_PASSIVE),
            (_WARNING, BusState.ERROR_WARNING),
            (_ACTIVE, BusState.ERROR_ACTIVE),
        ):
            if data[1] & bits:
                return state
    return None
