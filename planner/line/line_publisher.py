"""Tells people which line is aimed at: a thinned copy on the bus every few seconds, whoever joins late included."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hil_gateway.bus.interface import Bus
from hil_gateway.bus.race_line import RaceLine as Told
from hil_gateway.bus.topics import RACE_LINE
from hil_gateway.process.arrays import Array
from planner.line.raceline import OptimisedLine

POINTS = 500
"""at most; some 10 m on a 5 km lap, finer than a pixel of a map"""


class LinePublisher:
    """Publishes the line in use, at once and then every `RACE_LINE.period_ns`."""

    def __init__(self, bus: Bus) -> None:
        self._bus, self._due_ns, self._seq = bus, 0, 0

    def step(self, now_ns: int, line: OptimisedLine, clearance: float) -> None:
        """Say what is aimed at, when it is time; `clearance` as in the message, m."""
        if now_ns < self._due_ns:
            return
        self._due_ns = now_ns + RACE_LINE.period_ns
        self._bus.publish(RACE_LINE, race_line_message(line, clearance, now_ns, self._seq))
        self._seq += 1


def race_line_message(line: OptimisedLine, clearance: float, now_ns: int, seq: int) -> Told:
    """The message of a line."""
    step = -(-len(line.s) // POINTS)
    columns: Mapping[str, tuple[Array, int]] = {
        "x": (line.x, 2), "y": (line.y, 2), "vx": (line.vx_profile, 2), "track_s": (line.track_s, 1)
    }  # fmt: skip
    thinned = {name: tuple(np.round(values[::step], digits).tolist()) for name, (values, digits) in columns.items()}
    return Told(stamp_ns=now_ns, seq=seq, clearance_m=clearance, lap_time_s=round(line.lap_time, 3), **thinned)
