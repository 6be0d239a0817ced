"""The way through the pit lane: off the race line, along the middle of the lane, through a box, back onto the line.

It is a race line with a detour, so that nothing that plans, checks or falls back knows of pit lanes. Race line, lane
and box are joined by polynomials of fifth order in track coordinates (Werling et al. 2010): no jump of curvature.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import BPoly

from hil_gateway.process.arrays import Array
from hil_gateway.settings.gateway import CAUTION_DECELERATION
from hil_gateway.track.track import Box, Room, Track
from planner.line.detour import GENTLE, Detour, Index, aside, detour, opening, steered
from planner.line.joining import BEYOND
from planner.line.raceline import OptimisedLine
from planner.line.track import Reference
from planner.problem.settings import PlanLimits

TURNING = (4.0, 3.0, 2.0, 1.5, 1.0)
"""times the way on which lane and road touch: over so much the car goes from one to the other, by the longest that
keeps to both"""
STEEPEST = 10.0 / math.sqrt(3.0)
"""largest second derivative of a fifth-order step of height and length 1"""
MARGIN = 10.0
"""m of race line before and behind the way that count as part of it"""
STRAIGHT = 2.0
"""wheelbases that the way is straight before and behind a box: where the front wheels point there, the car does"""


@dataclass(frozen=True)
class PitRoute:
    """`reference` is another way than `base` from progress `begin` to `end`, with the box at `place`, m, of the lap in
    which it begins; without one `place` is its end."""

    begin: float
    place: float
    end: float
    way: Detour
    base: Reference
    reference: Reference

    @property
    def way_in(self) -> float:
        """From where it leaves the race line to the box, m."""
        return self.place - self.begin

    def holds(self, s: float) -> bool:
        """Whether a car at progress `s`, of any lap, is on it."""
        return (s - self.begin) % self.base.length <= self.end - self.begin


@dataclass(frozen=True)
class _Course:
    """Points of the race line's grid in driving order, (n,): number, arc length on the scale of the lane's, offset to
    the left of the centre line, m; where they have `room`."""

    index: Index
    along: Array
    offset: Array
    room: Room

    @property
    def least(self) -> float:
        """Distance to the nearest edge, m."""
        return float(min(self.room.left.min(), self.room.right.min()))


class PitRoutes:
    """Ways through the lane of a track for one car; `wheelbase` in m, `clearance` from edges to its middle, m."""

    def __init__(self, track: Track, wheelbase: float, limits: PlanLimits, clearance: float) -> None:
        assert track.pit_lane is not None
        self._track, self._lane, self._wheelbase = track, track.pit_lane, wheelbase
        self._narrow, self._bend_rate = clearance + limits.edge_zone, limits.steer_rate / wheelbase
        self._wanted = self._narrow - BEYOND
        apart = self._lane.s[track.room(self._lane.s, self._lane.offset).in_lane]
        self._apart = float(apart[0]), float(apart[-1])

    def through(self, base: Reference, box: Box | None) -> PitRoute | str:
        """From a race line by `box`, or past the boxes, and back; or why the car cannot drive there, in words."""
        found = [self._course(base.line, box, times) for times in TURNING]
        course = next((course for course in found if course.least >= self._wanted), None)
        if course is None:
            most = max(course.least for course in found)
            return (
                f"the way through the pit lane comes within {most:.2f} m of an edge, the car needs"
                f" {self._wanted:.2f} m: move the box, or widen the lane"
            )
        course = course if box is None else self._within(box, course)
        way, line = self._slowed(course, self._moved(base.line, course)), base.line
        s = line.s[course.index[0]] + line.length / len(line.s) * np.arange(len(course.index))
        place = float(s[-1]) if box is None else float(np.interp(box.s, course.along, s))
        return PitRoute(float(s[0]), place, float(s[-1]), way, base, Reference(way.on(line)))

    def again(self, route: PitRoute, base: Reference) -> PitRoute:
        """The same beside a race line whose path is the same and whose speeds are new."""
        return replace(route, base=base, reference=Reference(route.way.on(base.line), route.reference))

    def _course(self, line: OptimisedLine, box: Box | None, times: float) -> _Course:
        lane, length, apart = self._lane, self._track.length, self._apart
        begin, end = (a - times * (a - lane.s[i]) for a, i in zip(apart, (0, -1), strict=True))
        along = lane.s[0] + (line.track_s - lane.s[0] + 0.5 * length) % length - 0.5 * length
        index = np.argsort(along)  # with a margin, for the derivatives at the ends
        index = index[(begin - MARGIN <= along[index]) & (along[index] <= end + MARGIN)]
        along, race = along[index], aside(self._track, line)[index]
        offset = np.interp(along, lane.s, lane.offset)
        offset = _bridged(along, race, offset, (begin, apart[0]))
        offset = _bridged(along, offset, race, (apart[1], end))
        if box is not None:
            offset = self._by(box, along, offset)
        spacing, room = line.length / len(line.s), self._track.room(along, offset)
        room = room._replace(left=opening(room.left, spacing), right=opening(room.right, spacing))
        return _Course(index, along, offset, room)

    def _by(self, box: Box, along: Array, offset: Array) -> Array:
        """An offset led straight through a box, turned to and from at pit speed."""
        straight, before = STRAIGHT * self._wheelbase, float(np.interp(box.s, along, offset))
        turning = self._lane.speed * math.sqrt(STEEPEST * abs(box.offset - before) / GENTLE)
        gone = along - box.s
        near = _step(-np.abs(gone), -straight - turning - 1.0, -straight)
        return np.asarray(offset + (box.offset + math.tan(box.across) * gone - offset) * near)

    def _within(self, box: Box, course: _Course) -> _Course:
        """With so little room at the box that a plan goes through its middle: one that has more cares little where."""
        spacing = float(np.mean(np.diff(course.along)))
        beside = np.where(np.abs(course.along - box.s) <= STRAIGHT * self._wheelbase, self._narrow, np.inf)
        left, right = (opening(np.minimum(width, beside), spacing) for width in (course.room.left, course.room.right))
        return replace(course, room=course.room._replace(left=left, right=right))

    def _moved(self, line: OptimisedLine, course: _Course) -> Detour:
        index, heading = course.index, self._track.at(course.along).heading
        by = course.offset - aside(self._track, line)[index]
        x, y = line.x[index] - by * np.sin(heading), line.y[index] + by * np.cos(heading)
        return steered(detour(line, index, x, y, course.room), self._bend_rate)

    def _slowed(self, course: _Course, way: Detour) -> Detour:
        """With the lane's limit, from two points of the grid before its first to two behind its last line: speeds are
        linear between points, and a plan's stages meet them a point early or late."""
        (begin, end), cells = self._lane.limit, 2.0 * float(np.max(way.step))
        limited = (begin - cells <= course.along) & (course.along <= end + cells)
        fastest = np.where(limited, np.minimum(way.fastest, self._lane.speed), way.fastest)
        return replace(way, fastest=fastest, braking=CAUTION_DECELERATION)


def _bridged(s: Array, before: Array, after: Array, ends: tuple[float, float]) -> Array:
    """One curve over `s`, (n,), then another; between the `ends` the polynomial of fifth order from the one to the
    other with their values, slopes and second derivatives."""
    rows = [[np.interp(end, s, v) for v in _derivatives(s, y)] for end, y in zip(ends, (before, after), strict=True)]
    between = np.asarray(BPoly.from_derivatives(ends, rows)(np.clip(s, *ends)))
    return np.where(s < ends[0], before, np.where(s > ends[1], after, between))


def _derivatives(s: Array, y: Array) -> tuple[Array, Array, Array]:
    slope = np.gradient(y, s)
    return y, slope, np.gradient(slope, s)


def _step(x: Array, begin: float, end: float) -> Array:
    """Of fifth order from 0 at `begin` to 1 at `end`, constant beyond them."""
    t = np.clip((x - begin) / (end - begin), 0.0, 1.0)
    return np.asarray(t**3 * (10.0 - 15.0 * t + 6.0 * t**2))
