"""The race track: centre line, widths, elevation and bank over arc length.

Frame: local map (x east, y north, z up), metres; heading is measured from x to the left; the track runs in
the order of its points and is closed. `lateral` offsets are positive to the left of the centre line. `bank` is
positive when the left side is up, so a banked left turn has a negative one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from hil_gateway.process.arrays import Array

SPACING_M = 1.0
"""arc length between the points of a `Track`, at most"""
FAR = 1000.0
"""m beyond the line: no longer near"""


class TrackPoint(NamedTuple):
    """The track at one arc length (scalars) or at several (arrays of one shape); units as in `Track`."""

    x: Any
    y: Any
    z: Any
    heading: Any
    curvature: Any
    grade: Any
    bank: Any
    width_left: Any
    width_right: Any


class Box(NamedTuple):
    """Where a car stops in a pit lane: its centre of gravity at arc length `s`, on the scale of the lane's, and
    `offset` to the left of the track's centre line, m; its angle to that, `across`, rad."""

    s: float
    offset: float
    across: float = 0.0


@dataclass(frozen=True)
class PitLane:
    """A lane beside the track; arrays (n,): arc length of the track from its entry to its exit, m, beyond a lap where
    it crosses the line; offset of its middle to the left of the centre line, and widths from its middle, m."""

    s: Array
    offset: Array
    width_left: Array
    width_right: Array
    speed: float
    """m/s; the lane is driven no faster"""
    limit: tuple[float, float]
    """from where to where that holds, m, as `s`"""
    boxes: tuple[Box, ...] = ()

    def along(self, s: float | Array, length: float) -> Array:
        """Arc lengths of a track of `length` m on the scale of the lane's: not before its entry."""
        return np.asarray(self.s[0] + np.mod(np.asarray(s) - self.s[0], length))

    @cached_property
    def left(self) -> Array:
        """Offset of its left edge from the centre line of the track, m, (n,)."""
        return self.offset + self.width_left

    @cached_property
    def right(self) -> Array:
        """Offset of its right edge, m, (n,)."""
        return self.offset - self.width_right


class Room(NamedTuple):
    """Distance from a place to the left and to the right edge of where a car may be, m, negative beyond it; and whether
    that is the pit lane alone. Numbers, or arrays of one shape."""

    left: Any
    right: Any
    in_lane: Any


@dataclass(frozen=True)
class Track:
    """Closed centre line at equal steps of arc length; arrays have shape (n,), the last point is not the first again.

    `heading` is continuous along the lap (rad), `curvature` positive in left turns (1/m), `grade` the slope angle
    (rad, positive uphill), `bank` the cross slope angle (rad), widths are from the centre line (m). Arc length is
    that of the plan view.
    """

    name: str
    x: Array
    y: Array
    s: Array
    width_left: Array
    width_right: Array
    z: Array
    bank: Array
    heading: Array
    curvature: Array
    grade: Array
    length: float
    deviation: float
    """root mean square distance from the points of the file to the smoothed line, m"""
    closed: bool = True
    pit_lane: PitLane | None = None

    def level(self) -> Track:
        """The same course without slopes and bank."""
        flat = np.zeros_like(self.s)
        return replace(self, z=flat, bank=flat, grade=flat)

    @cached_property
    def turning(self) -> float:
        """Change of heading over a lap: 2 pi counter-clockwise, -2 pi clockwise."""
        last = self.heading[-1] + 0.5 * (self.curvature[-1] + self.curvature[0]) * (self.length - self.s[-1])
        return float(2.0 * np.pi * np.round((last - self.heading[0]) / (2.0 * np.pi)))

    @cached_property
    def _table(self) -> Array:
        """Rows as the fields of `TrackPoint`; one lap, its first point repeated at the end, shape (9, n + 1)."""
        rows = np.vstack([getattr(self, name) for name in TrackPoint._fields])
        end = rows[:, :1].copy()
        end[TrackPoint._fields.index("heading")] += self.turning
        return np.hstack([rows, end])

    @cached_property
    def _line(self) -> tuple[list[float], ...]:
        """x, y, heading, curvature as lists: reading single numbers out of lists is quicker than out of arrays."""
        return tuple(self._table[[0, 1, 3, 4]].tolist())

    @cached_property
    def _points(self) -> list[list[float]]:
        """Columns of `_table`, for single points."""
        return list(self._table.T.tolist())

    @cached_property
    def _surroundings(self) -> tuple[float, float, float, float]:
        """Least and greatest x, least and greatest y of what is near, m."""
        x, y = self.x, self.y
        return float(x.min()) - FAR, float(x.max()) + FAR, float(y.min()) - FAR, float(y.max()) + FAR

    def edges(self, inset: float = 0.0) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        """Left and right edge, `inset` m inside the road's, each as x and y of shape (n,), m."""
        across = -np.sin(self.heading), np.cos(self.heading)
        left, right = self.width_left - inset, inset - self.width_right
        return (
            (self.x + left * across[0], self.y + left * across[1]),
            (self.x + right * across[0], self.y + right * across[1]),
        )

    def lane_edges(self) -> tuple[tuple[Array, Array], tuple[Array, Array]] | None:
        """Left and right edge of the pit lane as x and y, m; None where there is none."""
        if (lane := self.pit_lane) is None:
            return None
        at = self.at(lane.s)
        left, right = ((at.x - e * np.sin(at.heading), at.y + e * np.cos(at.heading)) for e in (lane.left, lane.right))
        return left, right

    def box_pose(self, box: Box) -> tuple[float, float, float]:
        """x, y (m) and yaw (rad) of a car in a box."""
        at = self.at(box.s)
        x, y = at.x - box.offset * math.sin(at.heading), at.y + box.offset * math.cos(at.heading)
        return x, y, at.heading + box.across

    def room(self, s: float | Array, lateral: float | Array) -> Room:
        """Beside a car at arc length `s`, `lateral` m to the left of the centre line: on the road, in the pit lane, or
        on both where they touch; the nearer of the two for a car on neither."""
        at, lane = self.at(s), self.pit_lane
        left, right = at.width_left, -at.width_right
        if lane is None:
            return Room(left - lateral, lateral - right, np.zeros(np.shape(s), dtype=bool))
        along = lane.along(s, self.length)
        # not a number where there is no lane: it neither touches nor is near
        outer, inner = (np.interp(along, lane.s, edge, right=np.nan) for edge in (lane.left, lane.right))
        touches = (inner <= left) & (outer >= right)
        beyond = np.maximum(lateral - left, right - lateral), np.maximum(lateral - outer, inner - lateral)
        in_lane = ~touches & (beyond[1] < beyond[0])
        left = np.where(touches, np.fmax(left, outer), np.where(in_lane, outer, left))
        right = np.where(touches, np.fmin(right, inner), np.where(in_lane, inner, right))
        return Room(left - lateral, lateral - right, in_lane)

    def inside(self, s: float, lateral: float) -> float:
        """Distance from such a place to the nearer edge of where a car may be, m; negative beyond it."""
        if self._has_lane(s):
            room = self.room(s, lateral)
            return float(min(room.left, room.right))
        return self._on_road(s, lateral)

    def holds(self, s: float, lateral: float, room: float) -> bool:
        """Whether such a place has more than `room` m >= 0 to the nearer edge; a car that has it on the road needs no
        look at the pit lane."""
        return self._on_road(s, lateral) > room or (self._has_lane(s) and self.inside(s, lateral) > room)

    def _on_road(self, s: float, lateral: float) -> float:
        """Distance to the nearer edge of the road, m."""
        i = min(int(s / self.length * len(self.s)), len(self.s) - 1)
        return float(self.width_left[i] if lateral > 0 else self.width_right[i]) - abs(lateral)

    def in_lane(self, s: float, lateral: float) -> bool:
        """Whether such a place is in the pit lane alone."""
        return self._has_lane(s) and bool(self.room(s, lateral).in_lane)

    def _has_lane(self, s: float) -> bool:
        """Whether the pit lane runs beside the track there."""
        lane = self.pit_lane
        return lane is not None and bool((s - lane.s[0]) % self.length < lane.s[-1] - lane.s[0])

    def near(self, x: float, y: float) -> bool:
        """Whether a car that drives here can be at a point; one that is no number is nowhere."""
        west, east, south, north = self._surroundings
        return west < x < east and south < y < north

    def at(self, s: float | Array) -> TrackPoint:
        """Track at arc length `s`, any real number, linear between points; the heading grows by `turning` a lap."""
        if isinstance(s, float):
            return self._point(s)
        lap, along = np.divmod(np.asarray(s, dtype=float), self.length)
        position = along / (self.length / len(self.s))
        index = np.minimum(position.astype(np.int64), len(self.s) - 1)
        weight = position - index
        values = self._table[:, index] * (1.0 - weight) + self._table[:, index + 1] * weight
        values[3] += lap * self.turning
        return TrackPoint(*(values if values.ndim > 1 else values.tolist()))

    def _point(self, s: float) -> TrackPoint:
        lap, along = divmod(s, self.length)
        position = along / (self.length / len(self.s))
        i = min(int(position), len(self.s) - 1)
        weight = position - i
        pairs = zip(self._points[i], self._points[i + 1], strict=True)
        x, y, z, heading, *others = (before * (1.0 - weight) + after * weight for before, after in pairs)
        return TrackPoint(x, y, z, heading + lap * self.turning, *others)

    def project(self, x: float, y: float, hint: float | None = None) -> tuple[float, float]:
        """Arc length in [0, length) and lateral offset (m, positive left) of the nearest point of the centre line.

        `hint` is the arc length of a recent answer (within some 50 m): quicker, and right where two parts of the
        track run side by side. Without it all points are searched.
        """
        s = float(self.s[np.argmin((self.x - x) ** 2 + (self.y - y) ** 2)]) if hint is None else hint
        xs, ys, headings, curvatures = self._line
        n = len(xs) - 1
        spacing = self.length / n
        lateral = 0.0
        for _ in range(20):
            position = (s % self.length) / spacing
            i = min(int(position), n - 1)
            w = position - i
            heading = headings[i] + w * (headings[i + 1] - headings[i])
            cos, sin = math.cos(heading), math.sin(heading)
            dx = x - xs[i] - w * (xs[i + 1] - xs[i])
            dy = y - ys[i] - w * (ys[i + 1] - ys[i])
            lateral = cos * dy - sin * dx
            # Newton step; the clip keeps it finite for points near the centre of curvature
            step = (cos * dx + sin * dy) / max(0.3, 1.0 - curvatures[i] * lateral)
            s += max(-25.0, min(25.0, step))
            if abs(step) < 1e-3:
                break
        return s % self.length, lateral
