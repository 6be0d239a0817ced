"""Position fixes against the two receivers of race control, whose worth is learnt on the way.

Transponders report positions of their own (`marelli_gps_*` and MyLaps): without corrections, late by an unknown time,
with an error that wanders by metres in minutes. How far they lie beside the line of the fixes on average is what they
are worth. When both of them leave that line to the same side by much more than they used to, it is the fixes that
drift: neither heading nor wheels can tell.
"""

from __future__ import annotations

import math
from collections import deque

from hil_gateway.config import OriginConfig
from hil_gateway.gateway.perceive.monitors.held import Held
from hil_gateway.gateway.perceive.vehicle_state import VehicleStateBuilder
from hil_gateway.gateway.settings import PERIOD_S
from hil_gateway.track.geodesy import LocalMap

SIGNALS = {
    "marelli_report_2": ("marelli_gps_lat", "marelli_gps_long"),
    "mylaps_report_2": ("Latitude", "Longitude"),
}
LINE = 30
"""fixes: 1.5 s, as late as a receiver may be"""
STALE_S = 0.35
"""without a reading for so long a receiver says nothing: three are lost"""
SLOW = 3.0
"""m/s: slower, lateness is no distance, and where the line leads is noise"""
LEARNT = 0.025
"""weight of a reading: 4 s at 10 Hz, in which an uncorrected receiver wanders by a decimetre or two"""
SPREAD_LEARNT = 0.005
"""weight of a reading in the mean distance: 20 s, so that a drift of seconds is not taken for worse receivers"""
FIRST_SPREAD_M = 0.2
"""mean distance beside the line before anything is learnt"""
SPREADS = 5.0
"""mean distances, four standard deviations; for both receivers at once, to the same side"""
LEAST_M = 0.8
"""m: map, antennas, and a lead of the receivers in a bend"""
OUTLYING = 2.0
"""mean distances that one reading teaches at most"""
FAR_M = 30.0
"""m beside the line: no receiver that works, whatever its error; one without a view of the sky says zeros, and one that
hangs stays behind the line"""
TOGETHER, EITHER = 1.0, 0.4
"""of their bounds that both lie to one side on average, and each at least: healthy drives of 12 random cars (75 s each)
come to 0.76 on average, and the mean of two wanders by less than either"""
SMOOTHED_S = 0.3
"""time constant of how far they lie aside: three readings"""
PROVEN = 100
"""readings under way, 10 s, that lay within their bound before a receiver may contradict"""


class _Receiver:
    """One of them: its offset in the map, and how far it strays from it."""

    def __init__(self, message: str, local_map: LocalMap) -> None:
        self._message, self._map = message, local_map
        self._stamp_ns: int | None = None
        self._bias: tuple[float, float] | None = None
        self._spread_m = FIRST_SPREAD_M
        self._proven = 0
        self.share = 0.0
        """of its bound that its newest reading lies beside the line, positive to the left; 0 where it says nothing"""
        self.aside = (0.0, 0.0)
        """the line from that reading, m in the map"""

    def step(
        self, now_ns: int, builder: VehicleStateBuilder, line: deque[tuple[float, float]], speed: float, learns: bool
    ) -> None:
        """Takes in a new reading, if there is one; `line` are the newest fixes, which teach the receiver's offset where
        it `learns`."""
        age_s = builder.age_s(self._message, now_ns)
        if age_s > STALE_S:
            self.share = 0.0
            return
        stamp_ns = now_ns - round(1e9 * age_s)
        if stamp_ns == self._stamp_ns or len(line) < LINE:
            return
        self._stamp_ns = stamp_ns
        x, y = self._map.to_map_radians(*(builder.signal(name) for name in SIGNALS[self._message]))
        if self._bias is None or speed < SLOW:
            self._stand(x - line[-1][0], y - line[-1][1])
        else:
            self._compare(x - self._bias[0], y - self._bias[1], line, learns)

    def _stand(self, dx: float, dy: float) -> None:
        """Standing, both components of the offset show."""
        self._bias, self.share = (dx, dy), 0.0

    def _compare(self, x: float, y: float, line: deque[tuple[float, float]], learns: bool) -> None:
        """Under way only the one across the line does, whatever the lateness."""
        assert self._bias is not None
        nearest = min(range(len(line)), key=lambda i: (line[i][0] - x) ** 2 + (line[i][1] - y) ** 2)
        if nearest == 0 or math.hypot(line[nearest][0] - x, line[nearest][1] - y) > FAR_M:
            self._proven, self.share = 0, 0.0
            return
        left_m, (east, north) = _beside(x, y, line, nearest)
        bound = max(LEAST_M, SPREADS * self._spread_m)
        self._proven += abs(left_m) < bound
        self.share = left_m / bound if self._proven > PROVEN else 0.0
        self.aside = -left_m * east, -left_m * north
        if not learns:
            return
        most = OUTLYING * self._spread_m
        left_m = max(-most, min(left_m, most))
        self._bias = self._bias[0] + LEARNT * left_m * east, self._bias[1] + LEARNT * left_m * north
        self._spread_m += SPREAD_LEARNT * (abs(left_m) - self._spread_m)


class OtherReceivers:
    """Whether both lie far to one side of the fixes."""

    def __init__(self, origin: OriginConfig) -> None:
        local_map = LocalMap(origin)
        self._receivers = [_Receiver(message, local_map) for message in SIGNALS]
        self._line: deque[tuple[float, float]] = deque(maxlen=LINE)
        self._seq = 0
        self._held = Held()
        self.aside = (0.0, 0.0)
        """how far the fixes lie from the car as both of them say at least, m in the map; across the way alone"""

    def step(self, now_ns: int, builder: VehicleStateBuilder, speed: float, learns: bool = True) -> float:
        """Seconds they have; once a period. They learn nothing from fixes that are not believed."""
        fixes = builder.fixes
        if fixes.seq != self._seq:
            self._seq = fixes.seq
            self._line.append((fixes.x, fixes.y))
        for receiver in self._receivers:
            receiver.step(now_ns, builder, self._line, speed, learns)
        east, north = _nearer(*(receiver.aside for receiver in self._receivers))
        share = PERIOD_S / (PERIOD_S + SMOOTHED_S)
        self.aside = self.aside[0] + share * (east - self.aside[0]), self.aside[1] + share * (north - self.aside[1])
        one, other = (receiver.share for receiver in self._receivers)
        apart = abs(one + other) > 2.0 * TOGETHER and one * other > 0.0 and min(abs(one), abs(other)) > EITHER
        return self._held.update(apart, now_ns)


def _nearer(one: tuple[float, float], other: tuple[float, float]) -> tuple[float, float]:
    """The shorter of two."""
    return one if math.hypot(*one) < math.hypot(*other) else other


def _beside(x: float, y: float, line: deque[tuple[float, float]], nearest: int) -> tuple[float, tuple[float, float]]:
    """Distance of (x, y) to the left of the line at its nearest fix, m, and the direction that is (east, north)."""
    (x0, y0), (x1, y1) = line[max(nearest - 2, 0)], line[min(nearest + 2, len(line) - 1)]
    length = max(math.hypot(x1 - x0, y1 - y0), 1e-9)
    left = -(y1 - y0) / length, (x1 - x0) / length
    return left[0] * (x - line[nearest][0]) + left[1] * (y - line[nearest][1]), left
