"""The way from where a car stands onto the race line: what a plan follows until it is there.

A race line alone says nothing of a car that stands beside it or across the road: over a short horizon it costs less to
wait than to turn. So the path begins where the car is and as it points. It is rolled out beside the race line, by pure
pursuit (Coulter, 1992) with the steering angle and rate the car has, and takes its place on the same grid: progress
means the same on both, and from the end of the way on they are one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from hil_gateway.gateway.perceive.monitors.road import ACROSS
from hil_gateway.process.arrays import Array
from hil_gateway.track.track import Track
from planner.line.detour import Detour, aside, detour, opening, steered
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
BEYOND = 0.05
"""m a way may lead further beyond the edge than the car stands: less than a map knows"""
CUT = 0.1
"""m to either side that a plan may keep beside a way, however near an edge is: what acceptance tolerates"""

Pose = tuple[float, float, float]
"""x, y (m) and yaw (rad) in the map"""


@dataclass(frozen=True)
class Joined:
    """A reference that is `base` from progress `end` (m, less than half a lap from the line) on."""

    end: float
    way: Detour
    base: Reference
    reference: Reference

    def ended(self, s: float) -> bool:
        """Whether progress `s` is beyond its end."""
        return math.remainder(s - self.end, self.base.length) > 0.0


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
        offset, across = offset_and_angle(base, s, pose)
        if abs(across) > ACROSS:
            return f"the car points {math.degrees(abs(across)):.0f} degrees across the track: turn it"
        way = self._gentlest(base, _Start(s, offset, across, math.tan(steer) / self._wheelbase))
        if (short := way.beyond(self._limits.car_half_width)) > BEYOND:
            side = "left" if way.room[0] < way.room[1] else "right"
            return f"to turn into the track takes {short:.1f} m more road on the {side}: push or turn it"
        return self._joined(base, way, math.tan(across))

    def again(self, joined: Joined, base: Reference) -> Joined:
        """The same way onto a race line whose path is the same and whose speeds are new."""
        reference = Reference(joined.way.on(base.line), joined.reference, self._clearance + CUT)
        return replace(joined, base=base, reference=reference)

    def _gentlest(self, base: Reference, start: _Start) -> _JoiningPath:
        """The first that keeps clear of the edges, or the one that comes least near."""
        ways = []
        for preview in PREVIEWS:
            ways.append(self._roll(base, start, preview))
            if ways[-1].beyond(self._clearance + self._limits.edge_zone) <= BEYOND:
                return ways[-1]
        return max(ways, key=lambda way: min(way.room))

    def _roll(self, base: Reference, start: _Start, preview: float) -> _JoiningPath:
        """From progress, offset and angle to the race line on, until that is reached."""
        s, e, across, bend = start
        curvature = base.line.curvature
        spacing, n = base.length / len(curvature), len(curvature)
        rows, end = [(s, e)], s + LONGEST
        while s < end:
            along = float(curvature[math.floor(s / spacing) % n])
            lateral = -e * math.cos(across) - preview * math.sin(across)
            rate = math.cos(across) / max(1.0 - e * along, 0.2)
            wanted = along * rate + 2.0 * lateral / preview**2
            step = STEP / rate
            change = self._rate / ROLLED_AT * step
            bend += min(max(min(max(wanted, -self._most), self._most) - bend, -change), change)
            turned = bend * step - along * STEP
            e += step * math.sin(across + 0.5 * turned)
            across, s = across + turned, s + STEP
            rows.append((s, e))
            if abs(e) < MERGED[0] and abs(across) < MERGED[1]:
                end = min(end, s + BLEND)
        reached, offset = np.array(rows).T
        i = np.round(reached / spacing).astype(int) % n
        room = self._track.room(base.line.track_s[i], aside(self._track, base.line)[i] + offset)
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
        room = self._track.room(line.track_s[index], aside(self._track, line)[index] + offset)
        behind = int(np.searchsorted(s, way.s[0]))
        room = room._replace(left=opening(room.left, spacing, behind), right=opening(room.right, spacing, behind))
        heading = line.heading[index]
        x, y = line.x[index] - offset * np.sin(heading), line.y[index] + offset * np.cos(heading)
        found = steered(detour(line, index, x, y, room), self._rate)
        return Joined(float(way.s[-1]), found, base, Reference(found.on(line), None, self._clearance + CUT))


def offset_and_angle(reference: Reference, s: float, pose: Pose) -> tuple[float, float]:
    """Offset to the left of a reference at `s` (m) and angle to it (rad) of a pose."""
    point = reference.at(np.array([s]))
    heading, dx, dy = float(point.heading[0]), pose[0] - float(point.x[0]), pose[1] - float(point.y[0])
    offset = math.cos(heading) * dy - math.sin(heading) * dx
    return offset, math.remainder(pose[2] - heading, math.tau)
