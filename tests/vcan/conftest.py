"""Real SocketCAN interfaces for the tests: run through `deploy/with-vcan`."""

from __future__ import annotations

import itertools
import socket
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from hil_gateway.can_link.socketcan import SocketCanLink

_names = (f"vcant{number}" for number in itertools.count())


@contextmanager
def _fresh_interface() -> Iterator[str]:
    """A new vcan interface that is up; the test is skipped where there can be none."""
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError:
        pytest.skip("this kernel has no SocketCAN: run through deploy/with-vcan")
    name = next(_names)
    try:
        subprocess.run(["ip", "link", "add", name, "type", "vcan"], check=True, capture_output=True)
        subprocess.run(["ip", "link", "set", name, "up"], check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        pytest.skip(f"cannot create {name}: run through deploy/with-vcan")
    try:
        yield name
    finally:
        subprocess.run(["ip", "link", "del", name], check=False, capture_output=True)


@pytest.fixture
def channel() -> Iterator[str]:
    """Name of a fresh vcan interface."""
    with _fresh_interface() as name:
        yield name


@pytest.fixture(scope="module")
def shared_channel() -> Iterator[str]:
    """Name of a fresh vcan interface for all tests of a file."""
    with _fresh_interface() as name:
        yield name


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
