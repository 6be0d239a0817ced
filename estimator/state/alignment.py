"""Heading of a car that has just been found: which way the first metres lead that it goes.

Wheels and inertial unit give the way gone from an anchor, in axes that are turned against the map by an unknown
angle; the fixes give the same way in the map. Before there is one, the heading is not known at all.
"""

from __future__ import annotations

from math import atan2, hypot, pi, sqrt

from estimator.state.filter_steps import VX, VY
from estimator.state.state_filter import StateFilter

UNKNOWN_STD = pi / sqrt(3.0)
"""rad, of a direction that may be any"""
FOUND_STD = 0.1
"""rad: what is left of a heading's error is small enough for a linearised filter"""
SIGNED = 3.0
"""standard deviations by which a speed must differ from none for its direction to be known"""
AVERAGED = 20
"""fixes, 1 s, of which a standing car's place is the mean: longer, it wanders"""


class Alignment:
    """`stand` or `go` with every fix, `carry` in between; the way is in the axes of the filter."""

    def __init__(self, x: float, y: float) -> None:
        self._anchor(x, y)

    def _anchor(self, x: float, y: float) -> None:
        self.x, self.y, self._fixes = x, y, 1
        self._way = (0.0, 0.0)
        self._seconds = 0.0

    def carry(self, dx: float, dy: float, dt: float) -> None:
        """The car has gone on by so many m, in dt s."""
        self._way = self._way[0] + dx, self._way[1] + dy
        self._seconds += dt

    def stand(self, x: float, y: float) -> None:
        """A fix of a standing car."""
        fixes = min(self._fixes + 1, AVERAGED)
        self._anchor(self.x + (x - self.x) / fixes, self.y + (y - self.y) / fixes)
        self._fixes = fixes

    def go(self, x: float, y: float, f: StateFilter) -> tuple[float, float] | None:
        """Angle by which the axes of the filter are to be turned, and its deviation, rad, once they can be told."""
        east, north = x - self.x, y - self.y
        way, moved = hypot(*self._way), hypot(east, north)
        place_std, speed_std = self._place_std(f), f.std()
        if abs(way - moved) > SIGNED * hypot(place_std, 0.1 * way):
            self._anchor(x, y)
            return None
        vx = abs(float(f.mean[VX]))
        std = hypot(place_std / max(way, place_std), float(speed_std[VY]) / max(vx, place_std))
        if std > FOUND_STD or vx < SIGNED * speed_std[VX]:
            return None
        return atan2(north, east) - atan2(self._way[1], self._way[0]), std

    def _place_std(self, f: StateFilter) -> float:
        """Of the way between two fixes, m."""
        n, car, t = f.noise, f.car, self._seconds
        late = n.position_delay * abs(float(f.mean[VX]))
        return hypot(sqrt(2.0) * car.position, car.position_wander * sqrt(t), n.position_drift * t, late)
