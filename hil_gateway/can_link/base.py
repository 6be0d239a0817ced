"""What every CAN link offers, and the socket loop that SocketCAN and UDP share."""

from __future__ import annotations

import errno
import select
import socket
import time
from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from enum import StrEnum
from operator import attrgetter
from typing import Protocol

from hil_gateway.can_link.batch import SLOTS, SO_RXQ_OVFL, SO_TIMESTAMPNS, BatchReceiver
from hil_gateway.process.clock import NS_PER_S, wall_offset_ns

EXTENDED_ID = socket.CAN_EFF_FLAG
"""Set in `Frame.id` of 29-bit identifiers, so that none can pass for an 11-bit one."""
RECEIVE_BUFFER_BYTES = 8 * 1024 * 1024
"""Asked of the kernel: some 10,000 frames, more than a second of a full 1 Mbit/s bus."""
FRAMES_PER_CALL = 16_384
"""Bound of one `receive`: a flood cannot hold the caller for ever."""
RETRY_NS = 100_000_000
"""Pause between attempts to get a lost interface back."""
SO_RCVBUFFORCE = 33
_GONE = {errno.ENODEV, errno.ENXIO, errno.EBADF, errno.EADDRNOTAVAIL}
"""errors after which the socket itself is of no more use"""


class BusState(StrEnum):
    """Fault confinement state of the controller (ISO 11898-1), and what comes before there is one."""

    ERROR_ACTIVE = "error_active"
    ERROR_WARNING = "error_warning"
    ERROR_PASSIVE = "error_passive"
    BUS_OFF = "bus_off"
    DOWN = "down"


@dataclass(slots=True)
class Frame:
    """One classic CAN frame, or an error frame of the controller (`id` holds its error class bits)."""

    id: int
    data: bytes
    stamp_ns: int
    is_error: bool = False


@dataclass(slots=True)
class LinkStats:
    """Counts since the link was opened; `CanLink.stats` hands out copies."""

    bus_state: BusState = BusState.ERROR_ACTIVE
    received: int = 0
    sent: int = 0
    lost: int = 0
    """received by the kernel, dropped before we read them"""
    send_failures: int = 0
    error_frames: int = 0
    malformed: int = 0
    """what is no classic data frame: remote requests, foreign datagrams"""
    reopened: int = 0
    """times a lost interface came back"""

    def copy(self) -> LinkStats:
        """As they are now."""
        return LinkStats(*_COUNTS(self))


_COUNTS = attrgetter(*(field.name for field in fields(LinkStats)))


class CanLink(Protocol):
    """One end of the cable. Own frames are not received back."""

    kind: str

    def receive(self, timeout_s: float = 0.0) -> list[Frame]:
        """All pending frames, oldest first; waits at most `timeout_s` for the first."""
        ...

    def send(self, frame_id: int, data: bytes) -> bool:
        """Queue one frame; False when it could not be, which is counted."""
        ...

    def stats(self) -> LinkStats:
        """Counts and bus state."""
        ...

    def close(self) -> None:
        """Release the bus."""
        ...


class SocketLink(ABC):
    """A non-blocking datagram socket with kernel time stamps, overflow counter and reopening.

    Stamps: the kernel stamps in wall time; we move them to the monotonic clock and hold them between the last
    time the queue was seen empty and now, so that a step of the wall clock cannot make a frame look old or new.
    """

    kind: str

    def __init__(self) -> None:
        self.counts = LinkStats()
        self._socket: socket.socket | None = self._open()
        self._batch = BatchReceiver()
        self._kernel_drops = 0
        self._drained_ns = time.monotonic_ns()
        self._retry_ns = 0

    @abstractmethod
    def _open(self) -> socket.socket:
        """A bound socket; OSError when there is none to be had."""

    @abstractmethod
    def _parse(self, payload: bytes, stamp_ns: int) -> Frame | None:
        """The frame in a datagram; None for what is to be left out (counted by the callee)."""

    @abstractmethod
    def _pack(self, frame_id: int, data: bytes) -> bytes:
        """The datagram of a frame."""

    @abstractmethod
    def _transmit(self, target: socket.socket, payload: bytes) -> None:
        """Send one datagram; OSError when the kernel refuses it."""

    def receive(self, timeout_s: float = 0.0) -> list[Frame]:
        """See `CanLink.receive`. A lost interface gives no frames and is tried again every 0.1 s."""
        if self._socket is None or self.counts.bus_state is BusState.DOWN:
            self._recover()
        if self._socket is None:
            time.sleep(min(timeout_s, RETRY_NS / NS_PER_S))
            return []
        frames = self._drain(self._socket)
        if not frames and timeout_s > 0 and self._socket is not None:
            waiting = select.poll()
            waiting.register(self._socket, select.POLLIN)
            waiting.poll(1000 * timeout_s)
            frames = self._drain(self._socket)
        self.counts.received += len(frames)
        return frames

    def send(self, frame_id: int, data: bytes) -> bool:
        """See `CanLink.send`. Never blocks: a full transmit queue is a failure."""
        if self._socket is not None:
            try:
                self._transmit(self._socket, self._pack(frame_id, data))
            except OSError as error:
                self._fail(error)
            else:
                self.counts.sent += 1
                return True
        self.counts.send_failures += 1
        return False

    def stats(self) -> LinkStats:
        return self.counts.copy()

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _drain(self, source: socket.socket) -> list[Frame]:
        """Everything the kernel holds now, at most `FRAMES_PER_CALL`."""
        frames: list[Frame] = []
        earliest, offset, batch, count = self._drained_ns, wall_offset_ns(), self._batch, SLOTS
        while count == SLOTS and len(frames) < FRAMES_PER_CALL:
            try:
                count = batch.receive(source)
            except OSError as error:
                self._fail(error)
                break
            for payload, wall_ns, drops in batch.datagrams(count):
                if drops is not None:
                    self._count_drops(drops)
                stamp_ns = wall_ns - offset
                frame = self._parse(payload, stamp_ns if stamp_ns > earliest else earliest)
                if frame is not None:
                    frames.append(frame)
        now_ns = time.monotonic_ns()
        if count < SLOTS:
            self._drained_ns = now_ns
        _hold_back(frames, now_ns)
        return frames

    def _count_drops(self, kernel_total: int) -> None:
        """The kernel reports a 32-bit running total with every frame after the first loss."""
        if kernel_total != self._kernel_drops:
            self.counts.lost += (kernel_total - self._kernel_drops) % (1 << 32)
            self._kernel_drops = kernel_total

    def _fail(self, error: OSError) -> None:
        """A full queue is momentary; a missing network takes the link down; a gone device also costs the socket."""
        if error.errno in (errno.ENOBUFS, errno.EAGAIN):
            return
        self.counts.bus_state = BusState.DOWN
        if error.errno in _GONE:
            self.close()

    def _recover(self) -> None:
        """Try to leave `DOWN`, at most every `RETRY_NS`."""
        now_ns = time.monotonic_ns()
        if now_ns < self._retry_ns:
            return
        self._retry_ns = now_ns + RETRY_NS
        if self._socket is None:
            try:
                self._socket = self._open()
            except OSError:
                return
            self._kernel_drops = 0
        if self._is_up():
            self.counts.bus_state = BusState.ERROR_ACTIVE
            self.counts.reopened += 1

    def _is_up(self) -> bool:
        """Whether frames can flow at all."""
        return True


def _hold_back(frames: list[Frame], now_ns: int) -> None:
    """No frame comes from the future; after a step of the wall clock all of one drain seem to."""
    if frames and frames[-1].stamp_ns > now_ns:
        for frame in frames:
            frame.stamp_ns = min(frame.stamp_ns, now_ns)


def prepare(source: socket.socket) -> socket.socket:
    """Non-blocking, large receive buffer, kernel time stamps and drop counter; the same socket."""
    source.setblocking(False)
    try:
        source.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, RECEIVE_BUFFER_BYTES)
    except OSError:  # not root: as much as net.core.rmem_max allows
        source.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
    source.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
    source.setsockopt(socket.SOL_SOCKET, SO_RXQ_OVFL, 1)
    return source
