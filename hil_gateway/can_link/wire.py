"""A deterministic CAN cable inside one process, on the clock the loop runs on."""

from __future__ import annotations

from collections import deque

from hil_gateway.can_link.base import BusState, Frame, LinkStats
from hil_gateway.process.clock import Clock

QUEUE_FRAMES = 16_384
"""Bound of each receive queue; more is lost and counted, as on a real interface."""


class VirtualWire:
    """Every link hears all others and not itself, at once and in order. `up = False` is a pulled plug."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._links: list[WireLink] = []
        self.up = True

    def link(self) -> WireLink:
        """A further end of the cable."""
        link = WireLink(self)
        self._links.append(link)
        return link

    def transmit(self, sender: WireLink, frame_id: int, data: bytes) -> None:
        """Put a frame into every other queue; a full one loses the newest."""
        frame = Frame(frame_id, data, self._clock.now_ns())
        for link in self._links:
            if link is sender:
                continue
            if len(link.queue) < QUEUE_FRAMES:
                link.queue.append(frame)
            else:
                link.counts.lost += 1

    def remove(self, link: WireLink) -> None:
        """Unplug one end; unplugging twice does nothing."""
        if link in self._links:
            self._links.remove(link)


class WireLink:
    """One end of a `VirtualWire`."""

    kind = "wire"

    def __init__(self, wire: VirtualWire) -> None:
        self._wire = wire
        self.queue: deque[Frame] = deque()
        self.counts = LinkStats()

    def receive(self, timeout_s: float = 0.0) -> list[Frame]:
        """All pending frames; time does not pass inside a single-process loop, so nothing is waited for."""
        frames = list(self.queue)
        self.queue.clear()
        self.counts.received += len(frames)
        return frames

    def send(self, frame_id: int, data: bytes) -> bool:
        if not self._wire.up:
            self.counts.send_failures += 1
            return False
        self.counts.sent += 1
        self._wire.transmit(self, frame_id, data)
        return True

    def stats(self) -> LinkStats:
        self.counts.bus_state = BusState.ERROR_ACTIVE if self._wire.up else BusState.DOWN
        return self.counts.copy()

    def close(self) -> None:
        self._wire.remove(self)
