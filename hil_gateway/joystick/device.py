"""A joystick or steering wheel as Linux has it: events of `/dev/input/eventN`.

Source: the kernel's input subsystem, Documentation/input/event-codes.rst and include/uapi/linux/input.h. Its layout
is an ABI; the binding for Python would have to be compiled where the gateway is installed.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Mapping
from enum import IntEnum
from fcntl import ioctl
from pathlib import Path

from hil_gateway.process.errors import InputError

EVENT = struct.Struct("llHHi")
"""s, us, type, code, value"""
AXES: Mapping[str, int] = {
    name: code
    for code, name in enumerate(("x", "y", "z", "rx", "ry", "rz", "throttle", "rudder", "wheel", "gas", "brake"))
}
"""of absolute axes, as ABS_X is `x`"""
_RANGE = struct.Struct("6i")
"""value, minimum, maximum, fuzz, flat, resolution"""


class EventType(IntEnum):
    """EV_SYN, EV_KEY and EV_ABS."""

    SYNCHRONISE = 0
    KEY = 1
    AXIS = 3


DROPPED = (EventType.SYNCHRONISE, 3)
"""type and code (SYN_DROPPED): events were lost"""


class Device:
    """Positions and buttons, as far as `read` has taken them."""

    def __init__(self, path: Path) -> None:
        """Raises:
        InputError: no such device, no right to read it, or one without axes.
        """
        try:
            self._file = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        except OSError as error:
            raise InputError(f"{path}: {error.strerror}; `ls -l /dev/input/by-id`, group input may read") from None
        ranges = {name: _range(self._file, code) for name, code in AXES.items()}
        self.state = Controls({name: found for name, found in ranges.items() if found[0] < found[1]})
        if not self.state.ranges:
            os.close(self._file)
            raise InputError(f"{path}: no joystick or wheel: it has no axis; `ls -l /dev/input/by-id`")

    def read(self) -> bool:
        """Take what has happened; False where the device is gone."""
        try:
            while data := os.read(self._file, 64 * EVENT.size):
                self.state.take(data)
        except BlockingIOError:
            return True
        except OSError:
            self.state.release()
            return False
        return True

    def close(self) -> None:
        """Give the device back."""
        os.close(self._file)


class Controls:
    """Where axes and buttons are; `ranges` are the least and the greatest value of each axis."""

    def __init__(self, ranges: Mapping[str, tuple[int, int]]) -> None:
        self.ranges = ranges
        self.axes: dict[str, float] = {}
        """-1 to 1 of those that have moved"""
        self.pressed: set[int] = set()
        """codes of the buttons that were pressed since the device was opened"""
        self._name = {AXES[name]: name for name in ranges}

    def take(self, data: bytes) -> None:
        """Whole events, in order. Where some were lost no button counts as pressed: it has to be pressed again."""
        for _, _, kind, code, value in EVENT.iter_unpack(data[: len(data) // EVENT.size * EVENT.size]):
            if kind == EventType.KEY:
                (self.pressed.add if value else self.pressed.discard)(code)
            elif kind == EventType.AXIS and code in self._name:
                low, high = self.ranges[self._name[code]]
                self.axes[self._name[code]] = min(max(2.0 * (value - low) / (high - low) - 1.0, -1.0), 1.0)
            elif (kind, code) == DROPPED:
                self.release()

    def release(self) -> None:
        """No button is pressed."""
        self.pressed.clear()


def _range(file: int, code: int) -> tuple[int, int]:
    """Least and greatest value of an axis; equal where there is none."""
    request = (2 << 30) | (_RANGE.size << 16) | (ord("E") << 8) | (0x40 + code)  # EVIOCGABS
    try:
        _, low, high, *_ = _RANGE.unpack(ioctl(file, request, bytes(_RANGE.size)))
    except OSError:
        return 0, 0
    return low, high
