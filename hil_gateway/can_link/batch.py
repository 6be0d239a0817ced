"""Many datagrams in one system call: `recvmmsg(2)` with kernel time stamps and drop counter.

Python's own `recvmsg` costs about 2 us a frame, most of it for building the address and ancillary objects; this
costs 0.6 us (benchmarks/gateway.py). The layouts below are those of Linux on 64-bit machines.
"""

from __future__ import annotations

import ctypes
import errno
import os
import socket
from collections.abc import Iterator
from struct import Struct

from hil_gateway.process.clock import NS_PER_S

SLOTS = 128
"""Datagrams a call."""
PAYLOAD_BYTES = 512
"""Longer than anything a link takes for a frame; the rest of a longer datagram is cut off."""
SO_TIMESTAMPNS, SO_RXQ_OVFL = 35, 40

_CMSG_TIMESTAMP = Struct("@QiiqqQiiI4x")
"""cmsghdr and timespec, then cmsghdr and drop counter; the kernel writes the second only after the first drop"""
_TIMESTAMP_ONLY = 32
_CONTROL_BYTES = _CMSG_TIMESTAMP.size
_RESULT = Struct("@40xQi4xI4x")
"""of struct mmsghdr: msg_controllen, msg_flags, msg_len"""
_libc = ctypes.CDLL(None, use_errno=True)


class _IoVec(ctypes.Structure):
    _fields_ = (("base", ctypes.c_void_p), ("length", ctypes.c_size_t))


class _MessageHeader(ctypes.Structure):
    _fields_ = (
        ("name", ctypes.c_void_p),
        ("name_length", ctypes.c_uint32),
        ("iov", ctypes.c_void_p),
        ("iov_length", ctypes.c_size_t),
        ("control", ctypes.c_void_p),
        ("control_length", ctypes.c_size_t),
        ("flags", ctypes.c_int),
    )


class _Slot(ctypes.Structure):
    _fields_ = (("header", _MessageHeader), ("received", ctypes.c_uint32))


assert ctypes.sizeof(_Slot) == _RESULT.size


class BatchReceiver:
    """Reusable buffers for reading one socket."""

    def __init__(self) -> None:
        self._payloads = ctypes.create_string_buffer(SLOTS * PAYLOAD_BYTES)
        self._controls = ctypes.create_string_buffer(SLOTS * _CONTROL_BYTES)
        self._vectors = (_IoVec * SLOTS)()
        self._headers = (_Slot * SLOTS)()
        for slot in range(SLOTS):
            self._vectors[slot] = _IoVec(ctypes.addressof(self._payloads) + slot * PAYLOAD_BYTES, PAYLOAD_BYTES)
            header = self._headers[slot].header
            header.iov, header.iov_length = ctypes.addressof(self._vectors) + slot * ctypes.sizeof(_IoVec), 1
            header.control = ctypes.addressof(self._controls) + slot * _CONTROL_BYTES
            header.control_length = _CONTROL_BYTES
        self._fresh = bytes(self._headers)
        self._header_bytes = memoryview(self._headers).cast("B")
        self._payload_bytes = memoryview(self._payloads).cast("B")
        self._control_bytes = memoryview(self._controls).cast("B")

    def receive(self, source: socket.socket) -> int:
        """Read at most `SLOTS` waiting datagrams; their number, 0 when none waits.

        Raises:
            OSError: what the socket reports, for instance that its network went down.
        """
        self._header_bytes[:] = self._fresh  # the kernel overwrites lengths
        count: int = _libc.recvmmsg(source.fileno(), self._headers, SLOTS, socket.MSG_DONTWAIT, None)
        if count >= 0:
            return count
        code = ctypes.get_errno()
        if code in (errno.EAGAIN, errno.EINTR):
            return 0
        raise OSError(code, os.strerror(code))

    def datagrams(self, count: int) -> Iterator[tuple[bytes, int, int | None]]:
        """(payload, kernel stamp in Unix ns, running total of drops if there were any) of the last `receive`."""
        payloads, start = bytes(self._payload_bytes[: count * PAYLOAD_BYTES]), 0
        results = _RESULT.iter_unpack(self._header_bytes[: count * _RESULT.size])
        controls = _CMSG_TIMESTAMP.iter_unpack(self._control_bytes[: count * _CONTROL_BYTES])
        for (control_length, _, length), (_, _, _, seconds, nanoseconds, _, _, _, drops) in zip(
            results, controls, strict=True
        ):
            payload = payloads[start : start + length]
            yield payload, seconds * NS_PER_S + nanoseconds, drops if control_length > _TIMESTAMP_ONLY else None
            start += PAYLOAD_BYTES
