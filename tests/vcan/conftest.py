"""Real SocketCAN interfaces for the tests: run through `deploy/with-vcan`."""

from __future__ import annotations

import itertools
import socket
import subprocess
from collections.abc import Callable, Iterator

import pytest

from hil_gateway.can_link.socketcan import SocketCanLink

_names = (f"vcant{number}" for number in itertools.count())


def ip(*arguments: str) -> None:
    """Run `ip`, raising on failure."""
    subprocess.run(["ip", *arguments], check=True, capture_output=True, text=True)


@pytest.fixture
def channel() -> Iterator[str]:
    """Name of a fresh vcan interface that is up; the test is skipped where there can be none."""
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError:
        pytest.skip("this kernel has no SocketCAN: run through deploy/with-vcan")
    name = next(_names)
    try:
        ip("link", "add", name, "type", "vcan")
        ip("link", "set", name, "up")
    except (OSError, subprocess.CalledProcessError):
        pytest.skip(f"cannot create {name}: run through deploy/with-vcan")
    yield name
    subprocess.run(["ip", "link", "del", name], check=False, capture_output=True)


@pytest.fixture
def open_socketcan(channel: str) -> Iterator[Callable[[], SocketCanLink]]:
    """Opens links to the channel, closed after the test."""
    opened: list[SocketCanLink] = []

    def opener() -> SocketCanLink:
        opened.append(SocketCanLink(channel))
        return opened[-1]

    yield opener
    for link in opened:
        link.close()
