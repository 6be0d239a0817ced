"""Bytes of a receiver: TCP, serial line, or a file that was captured."""

from __future__ import annotations

import os
import select
import socket
import termios
import tty
from collections.abc import Iterator
from pathlib import Path

from hil_gateway.process.errors import InputError

CHUNK = 65_536
SPEEDS = {9600: termios.B9600, 115200: termios.B115200, 230400: termios.B230400, 460800: termios.B460800}
"""baud -> constant of termios(3)"""
TCP = "tcp://"


class Stream:
    """An open connection or line; `read` what has arrived."""

    def __init__(self, address: str, baud: int) -> None:
        """`address`: `tcp://HOST:PORT` or a device; a TCP connection may still be on its way.

        Raises:
            OSError: no such device, nobody listens, no route.
            ValueError: no address.
        """
        self._socket = _connecting(address) if address.startswith(TCP) else None
        self._descriptor = _line(address, baud) if self._socket is None else self._socket.fileno()

    def fileno(self) -> int:
        """For select(2)."""
        return self._descriptor

    def read(self) -> bytes | None:
        """What has arrived, at most `CHUNK` bytes, maybe nothing; None: it has ended.

        Raises:
            OSError: nobody listens, the line is gone.
        """
        try:
            return (self._socket.recv(CHUNK) if self._socket else os.read(self._descriptor, CHUNK)) or None
        except BlockingIOError:
            return b""

    def close(self) -> None:
        """End it."""
        if self._socket is not None:
            self._socket.close()
        else:
            os.close(self._descriptor)


def chunks(source: str, baud: int) -> Iterator[bytes]:
    """What arrives, at least every 100 ms, maybe nothing; ends with the file or the connection.

    Args:
        source: `tcp://HOST:PORT`, a device, or a file.
        baud: of a serial line.

    Raises:
        InputError: no such file or device, nobody listens, a speed that serial lines do not have.
    """
    if baud not in SPEEDS:
        raise InputError(f"--baud {baud}: there are {', '.join(map(str, SPEEDS))}")
    try:
        if source.startswith(TCP) or Path(source).is_char_device():
            yield from _arriving(Stream(source, baud))
        else:
            with Path(source).open("rb") as file:
                yield from iter(lambda: file.read(CHUNK), b"")
    except (OSError, ValueError, OverflowError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{source}: {reason}; give tcp://HOST:PORT, a serial device or a captured file") from None


def _arriving(stream: Stream) -> Iterator[bytes]:
    try:
        while True:
            ready, _, _ = select.select([stream], [], [], 0.1)
            data = stream.read() if ready else b""
            if data is None:
                return
            yield data
    finally:
        stream.close()


def _connecting(address: str) -> socket.socket:
    """Does not wait: reading says when it has failed."""
    host, _, port = address.removeprefix(TCP).rpartition(":")
    family, kind, protocol, _, place = socket.getaddrinfo(host, int(port), type=socket.SOCK_STREAM)[0]
    connection = socket.socket(family, kind, protocol)
    connection.setblocking(False)
    try:
        connection.connect(place)
    except BlockingIOError:
        pass
    except OSError:
        connection.close()
        raise
    return connection


def _line(device: str, baud: int) -> int:
    line = os.open(device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        tty.setraw(line)
        settings = termios.tcgetattr(line)
        settings[4] = settings[5] = SPEEDS[baud]
        termios.tcsetattr(line, termios.TCSANOW, settings)
    except termios.error as error:
        os.close(line)
        raise OSError(*error.args) from None
    return line
