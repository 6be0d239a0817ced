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
CONNECT_S = 3.0
SPEEDS = {9600: termios.B9600, 115200: termios.B115200, 230400: termios.B230400, 460800: termios.B460800}
"""baud -> constant of termios(3)"""


def chunks(source: str, baud: int) -> Iterator[bytes]:
    """What arrives, at least every 100 ms, maybe nothing; ends with the file or the connection.

    Args:
        source: `tcp://HOST:PORT`, a device, or a file.
        baud: of a serial line.

    Raises:
        InputError: no such file or device, nobody listens, a speed that serial lines do not have.
    """
    try:
        if source.startswith("tcp://"):
            host, _, port = source.removeprefix("tcp://").rpartition(":")
            with socket.create_connection((host, int(port)), CONNECT_S) as connection:
                yield from _arriving(connection.fileno())
        elif Path(source).is_char_device():
            yield from _serial(source, baud)
        else:
            with Path(source).open("rb") as file:
                yield from iter(lambda: file.read(CHUNK), b"")
    except (OSError, ValueError, OverflowError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{source}: {reason}; give tcp://HOST:PORT, a serial device or a captured file") from None


def _serial(device: str, baud: int) -> Iterator[bytes]:
    if baud not in SPEEDS:
        raise InputError(f"--baud {baud}: there are {', '.join(map(str, SPEEDS))}")
    line = os.open(device, os.O_RDWR | os.O_NOCTTY)
    try:
        tty.setraw(line)
        settings = termios.tcgetattr(line)
        settings[4] = settings[5] = SPEEDS[baud]
        termios.tcsetattr(line, termios.TCSANOW, settings)
        yield from _arriving(line)
    finally:
        os.close(line)


def _arriving(descriptor: int) -> Iterator[bytes]:
    while True:
        ready, _, _ = select.select([descriptor], [], [], 0.1)
        data = os.read(descriptor, CHUNK) if ready else b""
        if ready and not data:
            return
        yield data
