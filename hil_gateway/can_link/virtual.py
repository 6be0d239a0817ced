"""python-can's `virtual` bus: threads of one process."""

from __future__ import annotations

import time

from hil_gateway.can_link.base import EXTENDED_ID, FRAMES_PER_CALL, Frame, LinkStats
from hil_gateway.process.clock import NS_PER_S, wall_offset_ns


class VirtualLink:
    """One end of python-can's in-process bus, with a bounded queue."""

    kind = "virtual"

    def __init__(self, channel: str) -> None:
        import can

        self._can = can
        self._bus = can.Bus(interface="virtual", channel=channel, rx_queue_size=FRAMES_PER_CALL)
        self.counts = LinkStats()

    def receive(self, timeout_s: float = 0.0) -> list[Frame]:
        frames: list[Frame] = []
        offset = wall_offset_ns()
        message = self._bus.recv(timeout_s)
        while message is not None:
            frame_id = message.arbitration_id | (EXTENDED_ID if message.is_extended_id else 0)
            stamp_ns = min(int(message.timestamp * NS_PER_S) - offset, time.monotonic_ns())
            frames.append(Frame(frame_id, bytes(message.data), stamp_ns, message.is_error_frame))
            message = self._bus.recv(0) if len(frames) < FRAMES_PER_CALL else None
        self.counts.received += len(frames)
        return frames

    def send(self, frame_id: int, data: bytes) -> bool:
        extended = bool(frame_id & EXTENDED_ID)
        message = self._can.Message(arbitration_id=frame_id & ~EXTENDED_ID, data=data, is_extended_id=extended)
        try:
            self._bus.send(message)
        except self._can.CanError:
            self.counts.send_failures += 1
            return False
        self.counts.sent += 1
        return True

    def stats(self) -> LinkStats:
        return self.counts.copy()

    def close(self) -> None:
        self._bus.shutdown()
