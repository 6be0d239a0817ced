"""The way from where a car stands onto the race line: what a plan follows until it is there.

A race line alone says nothing of a car that stands beside it or across the road: over a short horizon it costs less to
wait than to turn. So the path begins where the car is and as it points. It is rolled out beside the race line, by pure
pursuit (Coulter, 1992) with the steering angle and rate the car has, and takes its place on the same grid: progress
means the same on both, and from the end of the way on they are one. In the pit lane it aims at the middle of the lane
until that touches the road.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

from hil_gateway.process.arrays import Array
from hil_gateway.track.track import Room, Track
from planner.line.raceline import OptimisedLine
from planner.line.track import Reference
from planner.problem.settings import PlanLimits

STEP = 0.5
"""m of progress between points of the roll-out"""
LONGEST = 300.0
"""m on the road after which what is left of the way is blended into the race line"""
PREVIEWS = (30.0, 20.0, 13.0, 8.0)
"""m ahead of the car at which it aims: the gentlest way that keeps to the road is taken"""
ROLLED_AT = 3.0
"""m/s, walking pace: sets how much steering a metre the steering rate allows"""
STEER_USE = 0.9
"""of the steering angle: the rest is for the controller"""
MERGED = 0.3, 0.05
"""m and rad from the race line at which the rest of the way is blended into it, over `BLEND` m"""
BLEND = 20.0
BEHIND = 16.0
"""m the path goes on straight behind the car: a spline through the corner there is smooth again where the car is"""
GENTLE = 5.0
"""m/s2, along and across: half of what dry tyres hold"""
BEYOND = 0.05
"""m a way may lead further beyond the edge than the car stands: less than a map knows"""
CUT = 0.1
"""m to either side that a plan may keep beside a way, however near an edge is: what acceptance tolerates"""
MOST_ACROSS = math.radians(60.0)
"""angle to the road beyond which a car is no longer one that follows it"""

OPENING = 0.3
"""m a metre by which the room beside a way grows where road and pit lane meet"""
SLIGHT = 1e-6
"""of a curvature, 1/m, or its slope: none"""
MOVED = ("x", "y", "heading", "curvature", "width_left", "width_right", "grade", "bank")
"""what of a race line is another beside it"""

Index = npt.NDArray[np.intp]
Pose = tuple[float, float, float]
"""x, y (m) and yaw (rad) in the map"""


@dataclass(frozen=True)
class _Own:
    """Points of the grid that are not the race line's, in the order of driving, arrays (n,): their number, the distance
    to the next one, m, and the speed there by itself, m/s."""

    index: Index
    step: Array
    fastest: Array

    def speeds(self, line: OptimisedLine) -> Array:
        """Of a whole lap: those of the race line, no faster than its own, and braked for gently."""
        v = line.vx_profile.copy()
        v[self.index] = np.minimum(v[self.index], self.fastest)
        for i, step in zip(self.index[::-1], self.step[::-1], strict=True):
            v[i] = min(v[i], math.sqrt(v[(i + 1) % len(v)] ** 2 + 2.0 * GENTLE * step))
        return v


@dataclass(frozen=True)
class Joined:
    """A reference that is `base` from progress `end` (m, less than half a lap from the line) on."""

    end: float
    own: _Own
    base: Reference
    reference: Reference


class _Start(NamedTuple):
    """Progress (m), offset to the left of the race line (m), angle to it (rad) and curvature (1/m) of the path."""

    s: float
    offset: float
    across: float
    bend: float


@dataclass(frozen=True)
class _JoiningPath:
    """A roll-out: progress along the race line and offset to its left, m, arrays (n,); the least distance to the left
    and to the right edge of road or pit lane, m, and that to the nearer one where it begins."""

    s: Array
    offset: Array
    room: tuple[float, float]
    begun: float

    def beyond(self, distance: float) -> float:
        """How far it leads beyond a `distance` from the edges, m, by more than the car stands beyond it at first."""
        return distance - min(self.room) - max(distance - self.begun, 0.0)


@dataclass(frozen=True)
class _Aim:
    """What is pursued, at the points of the race line, (n,): offset to its left, m, while the car is where `in_lane`;
    else the race line itself."""

    offset: Array
    in_lane: npt.NDArray[np.bool_]


class Joining:
    """Ways onto the race line of one track for one car; `wheelbase` in m."""

    def __init__(self, track: Track, wheelbase: float, limits: PlanLimits, clearance: float) -> None:
        """`clearance`: distance from the edges at which the solver's corridor ends, m."""
        self._track, self._wheelbase, self._limits, self._clearance = track, wheelbase, limits, clearance
        self._most = math.tan(STEER_USE * limits.steer) / wheelbase
        self._rate = limits.steer_rate / wheelbase

    def join(self, base: Reference, pose: Pose, steer: float) -> Joined | str:
        """From `pose` with the wheels turned by `steer` (rad); or why there is no way, in words."""
        s = base.find(pose[0], pose[1])
        offset, across = beside(base, s, pose)
        if abs(across) > MOST_ACROSS:
            return f"the car points {math.degrees(abs(across)):.0f} degrees across the track: turn it"
        way = self._gentlest(base, _Start(s, offset, across, math.tan(steer) / self._wheelbase))
        if (short := way.beyond(self._limits.car_half_width)) > BEYOND:
            side = "left" if way.room[0] < way.room[1] else "right"
            return f"to turn into the track takes {short:.1f} m more road on the {side}: push or turn it"
        return self._joined(base, way, math.tan(across))

    def again(self, joined: Joined, base: Reference) -> Joined:
        """The same way onto a race line whose path is the same and whose speeds are new."""
        line = joined.reference.line
        line = replace(line, vx_profile=joined.own.speeds(base.line))
        return replace(joined, base=base, reference=Reference(line, joined.reference, self._clearance + CUT))

    def _gentlest(self, base: Reference, start: _Start) -> _JoiningPath:
        """The first that keeps clear of the edges, or the one that comes least near."""
        ways = []
        for aim, preview in product(self._aims(base.line, start), PREVIEWS):
            ways.append(self._roll(base, aim, start, preview))
            if ways[-1].beyond(self._clearance + self._limits.edge_zone) <= BEYOND:
                return ways[-1]
        return max(ways, key=lambda way: min(way.room))

    def _aims(self, line: OptimisedLine, start: _Start) -> list[_Aim]:
        """The race line, unless the car is in the lane alone; the middle of the lane, where the car can be in it."""
        n, lane, track_s, aside = len(line.s), self._track.pit_lane, line.track_s, self._aside(line)
        onto_road = _Aim(np.zeros(n), np.zeros(n, dtype=bool))
        if lane is None:
            return [onto_road]
        along = lane.s[0] + (track_s - lane.s[0]) % self._track.length
        middle = np.interp(along, lane.s, lane.offset)
        apart = np.asarray(self._track.room(track_s, middle).in_lane) & (along <= lane.s[-1])
        i = round(start.s / line.length * n) % n
        before = along[i] <= np.max(along, where=apart, initial=-np.inf)
        through = [_Aim(middle - aside, along <= np.max(along, where=apart, initial=-np.inf))] if before else []
        in_lane = self._track.room(float(track_s[i]), float(aside[i]) + start.offset).in_lane
        return through if in_lane else [onto_road, *through]

    def _aside(self, line: OptimisedLine) -> Array:
        """Offset of the race line to the left of the centre line, m, (n,)."""
        return np.asarray(self._track.at(line.track_s).width_left - line.width_left)

    def _roll(self, base: Reference, aim: _Aim, start: _Start, preview: float) -> _JoiningPath:
        """From progress, offset and angle to the race line on, until that is reached."""
        s, e, across, bend = start
        curvature = base.line.curvature
        spacing, n = base.length / len(curvature), len(curvature)
        rows, end = [(s, e)], math.inf
        while s < end:
            i = math.floor(s / spacing) % n
            along, in_lane = float(curvature[i]), bool(aim.in_lane[i])
            wanted_e = float(aim.offset[math.floor((s + preview) / spacing) % n]) if in_lane else 0.0
            lateral = (wanted_e - e) * math.cos(across) - preview * math.sin(across)
            rate = math.cos(across) / max(1.0 - e * along, 0.2)
            wanted = along * rate + 2.0 * lateral / preview**2
            step = STEP / rate
            change = self._rate / ROLLED_AT * step
            bend += min(max(min(max(wanted, -self._most), self._most) - bend, -change), change)
            turned = bend * step - along * STEP
            e += step * math.sin(across + 0.5 * turned)
            across, s = across + turned, s + STEP
            rows.append((s, e))
            if not in_lane:
                merged = abs(e) < MERGED[0] and abs(across) < MERGED[1]
                end = min(end, s + (BLEND if merged else LONGEST))
        reached, offset = np.array(rows).T
        i = np.round(reached / spacing).astype(int) % n
        room = self._track.room(base.line.track_s[i], self._aside(base.line)[i] + offset)
        least = float(room.left.min()), float(room.right.min())
        return _JoiningPath(reached, offset, least, min(float(room.left[0]), float(room.right[0])))

    def _joined(self, base: Reference, way: _JoiningPath, slope: float) -> Joined:
        """The way in place of the race line; `slope` of the offset where it begins."""
        line, spacing, n = base.line, base.length / len(base.line.s), len(base.line.s)
        number = np.arange(math.ceil((way.s[0] - BEHIND) / spacing), math.ceil(way.s[-1] / spacing))
        s, index = number * spacing, number % n
        offset = np.where(s < way.s[0], way.offset[0] + slope * (s - way.s[0]), CubicSpline(way.s, way.offset)(s))
        left = np.clip((way.s[-1] - s) / BLEND, 0.0, 1.0)
        offset *= left**2 * (3.0 - 2.0 * left)
        room = self._track.room(line.track_s[index], self._aside(line)[index] + offset)
        behind = int(np.searchsorted(s, way.s[0]))
        left, right = (_opening(width, spacing, behind) for width in (room.left, room.right))
        room = room._replace(left=left, right=right)
        joined = _moved(line, index, offset, room)
        step = np.hypot(*(np.diff(row[[*index, (index[-1] + 1) % n]]) for row in (joined.x, joined.y)))
        own = _Own(index, step, self._fastest(joined.curvature[index], step, np.asarray(room.in_lane)))
        joined = replace(joined, vx_profile=own.speeds(line))
        return Joined(float(way.s[-1]), own, base, Reference(joined, None, self._clearance + CUT))

    def _fastest(self, curvature: Array, step: Array, in_lane: npt.NDArray[np.bool_]) -> Array:
        """Speeds, m/s, of a gentle way with the steering rate the car has; of curvature and steps (m) of its points."""
        change = np.abs(np.gradient(curvature)) / step
        fastest = np.sqrt(GENTLE / np.maximum(np.abs(curvature), SLIGHT))
        fastest = np.minimum(fastest, self._rate / np.maximum(change, SLIGHT))
        lane = self._track.pit_lane
        return fastest if lane is None else np.where(in_lane, np.minimum(fastest, lane.speed), fastest)


def _opening(width: Array, spacing: float, first: int) -> Array:
    """Widths (n,) at points `spacing` m apart that change by `OPENING` at most: what opens suddenly opens gradually, so
    that between points it is what it is at them. Those before the `first` are as that: there is no way."""
    slope = OPENING * spacing * np.arange(len(width))
    width = np.concatenate([np.full(first, width[first]), width[first:]])
    for way in (1, -1):
        width = (np.minimum.accumulate(width[::way] - slope) + slope)[::way]
    return width


def beside(reference: Reference, s: float, pose: Pose) -> tuple[float, float]:
    """Offset to the left of a reference at `s` (m) and angle to it (rad) of a pose."""
    point = reference.at(np.array([s]))
    heading, dx, dy = float(point.heading[0]), pose[0] - float(point.x[0]), pose[1] - float(point.y[0])
    offset = math.cos(heading) * dy - math.sin(heading) * dx
    return offset, math.remainder(pose[2] - heading, math.tau)


def _moved(line: OptimisedLine, index: Index, offset: Array, room: Room) -> OptimisedLine:
    """The line with the points `index` moved to the left by `offset` (m), where they have `room`; with its speeds."""
    changed = {name: getattr(line, name).copy() for name in MOVED}
    heading = line.heading[index]
    changed["x"][index] -= offset * np.sin(heading)
    changed["y"][index] += offset * np.cos(heading)
    changed["width_left"][index], changed["width_right"][index] = room.left, room.right
    spline = CubicSpline(np.arange(len(index)), np.column_stack([changed["x"][index], changed["y"][index]]))
    (dx, dy), (ddx, ddy) = spline(np.arange(len(index)), 1).T, spline(np.arange(len(index)), 2).T
    across = np.angle(np.exp(1j * (np.arctan2(dy, dx) - heading)))
    changed["heading"][index] += across
    changed["curvature"][index] = (dx * ddy - dy * ddx) / np.hypot(dx, dy) ** 3
    uphill, left_up = np.sin(line.grade[index]), np.sin(line.bank[index])
    changed["grade"][index] = np.arcsin(np.cos(across) * uphill + np.sin(across) * left_up)
    changed["bank"][index] = np.arcsin(np.cos(across) * left_up - np.sin(across) * uphill)
    return replace(line, **changed)
