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
import numpy.typing as npt
from scipy.interpolate import CubicSpline

from hil_gateway.process.arrays import Array
from planner.line.raceline import RaceLine
from planner.line.track import Reference
from planner.problem.settings import Limits

STEP = 0.5
"""m of progress between points of the roll-out"""
LONGEST = 300.0
"""m after which what is left of the way is blended into the race line"""
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
MOST_ACROSS = math.radians(60.0)
"""angle to the road beyond which a car is no longer one that follows it"""

SLIGHT = 1e-6
"""of a curvature, 1/m, or its slope: none"""
MOVED = ("x", "y", "heading", "curvature", "width_left", "width_right", "grade", "bank")
"""what of a race line is another beside it"""

Index = npt.NDArray[np.intp]
Pose = tuple[float, float, float]
"""x, y (m) and yaw (rad) in the map"""


@dataclass(frozen=True)
class Joined:
    """A reference that is `base` from progress `end` (m, less than half a lap from the line) on."""

    end: float
    index: Index
    """points of the grid that are its own, in the order of driving"""
    base: Reference
    reference: Reference


class _Start(NamedTuple):
    """Progress (m), offset to the left of the race line (m), angle to it (rad) and curvature (1/m) of the path."""

    s: float
    offset: float
    across: float
    bend: float


@dataclass(frozen=True)
class _Way:
    """A roll-out: progress along the race line (m) and offset to its left (m), arrays (n,); how far beyond the left and
    the right edge of the road it leads, m, by more than the car stands beyond one."""

    s: Array
    offset: Array
    beyond: tuple[float, float]


class Joining:
    """Ways onto a race line for one car; `wheelbase` in m."""

    def __init__(self, wheelbase: float, limits: Limits, room: float) -> None:
        """`room` is the least distance (m) from the path to the bounds of the solver's corridor."""
        self._wheelbase, self._limits, self._room = wheelbase, limits, room
        self._most = math.tan(STEER_USE * limits.steer) / wheelbase
        self._rate = limits.steer_rate / wheelbase

    def join(self, base: Reference, pose: Pose, steer: float) -> Joined | str:
        """From `pose` with the wheels turned by `steer` (rad); or why there is no way, in words."""
        s = base.find(pose[0], pose[1])
        offset, across = beside(base, s, pose)
        if abs(across) > MOST_ACROSS:
            return f"the car points {math.degrees(abs(across)):.0f} degrees across the track: turn it"
        way = self._gentlest(base, _Start(s, offset, across, math.tan(steer) / self._wheelbase))
        if max(way.beyond) > BEYOND:
            side = "left" if way.beyond[0] > way.beyond[1] else "right"
            return f"to turn into the track takes {max(way.beyond):.1f} m more road on the {side}: push or turn it"
        return self._joined(base, way, math.tan(across))

    def again(self, joined: Joined, base: Reference) -> Joined:
        """The same way onto a race line whose path is the same and whose speeds are new."""
        line = joined.reference.line
        line = replace(line, vx_profile=self._speeds(line, base.line, joined.index))
        return replace(joined, base=base, reference=Reference(line, joined.reference, self._room))

    def _gentlest(self, base: Reference, start: _Start) -> _Way:
        """The first that keeps to the road, or the one that leaves it least."""
        best: _Way | None = None
        for preview in PREVIEWS:
            way = self._roll(base, start, preview)
            if best is None or max(way.beyond) < max(best.beyond):
                best = way
            if max(best.beyond) <= BEYOND:
                break
        assert best is not None
        return best

    def _roll(self, base: Reference, start: _Start, preview: float) -> _Way:
        """From progress, offset and angle to the race line on, until that is reached."""
        s, e, across, bend = start
        curvature = base.line.curvature
        spacing, n = base.length / len(curvature), len(curvature)
        rows, merged = [(s, e)], math.inf
        while s - start.s < min(LONGEST, merged + BLEND):
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
            if math.isinf(merged) and abs(e) < MERGED[0] and abs(across) < MERGED[1]:
                merged = s - start.s
        reached, offset = np.array(rows).T
        return _Way(reached, offset, self._beyond(base, reached, offset))

    def _beyond(self, base: Reference, s: Array, offset: Array) -> tuple[float, float]:
        """How far beyond the left and the right edge a way leads, by more than it begins beyond one, m."""
        line, half = base.line, self._limits.car_half_width
        left, right = (np.interp(s, line.s, w, period=line.length) for w in (line.width_left, line.width_right))
        over = offset + half - left, half - right - offset
        begun = max(float(over[0][0]), float(over[1][0]), 0.0)
        return float(over[0].max()) - begun, float(over[1].max()) - begun

    def _joined(self, base: Reference, way: _Way, slope: float) -> Joined:
        """The way in place of the race line; `slope` of the offset where it begins."""
        line, spacing, n = base.line, base.length / len(base.line.s), len(base.line.s)
        number = np.arange(math.ceil((way.s[0] - BEHIND) / spacing), math.ceil(way.s[-1] / spacing))
        s, index = number * spacing, number % n
        offset = np.where(s < way.s[0], way.offset[0] + slope * (s - way.s[0]), CubicSpline(way.s, way.offset)(s))
        left = np.clip((way.s[-1] - s) / BLEND, 0.0, 1.0)
        joined = _moved(line, index, offset * left**2 * (3.0 - 2.0 * left))
        joined = replace(joined, vx_profile=self._speeds(joined, line, index))
        return Joined(float(way.s[-1]), index, base, Reference(joined, None, self._room))

    def _speeds(self, joined: RaceLine, line: RaceLine, index: Index) -> Array:
        """Of the race line, and no faster than a gentle way with the steering rate the car has, m/s."""
        step = np.hypot(*(np.diff(values[[*index, (index[-1] + 1) % len(values)]]) for values in (joined.x, joined.y)))
        bend = np.abs(joined.curvature[index])
        change = np.abs(np.gradient(joined.curvature[index])) / step
        most = np.minimum(np.sqrt(GENTLE / np.maximum(bend, SLIGHT)), self._rate / np.maximum(change, SLIGHT))
        v = line.vx_profile.copy()
        v[index] = np.minimum(v[index], most)
        for i, ds in zip(index[::-1], step[::-1], strict=True):
            v[i] = min(v[i], math.sqrt(v[(i + 1) % len(v)] ** 2 + 2.0 * GENTLE * ds))
        return v


def beside(reference: Reference, s: float, pose: Pose) -> tuple[float, float]:
    """Offset to the left of a reference at `s` (m) and angle to it (rad) of a pose."""
    point = reference.at(np.array([s]))
    heading, dx, dy = float(point.heading[0]), pose[0] - float(point.x[0]), pose[1] - float(point.y[0])
    offset = math.cos(heading) * dy - math.sin(heading) * dx
    return offset, math.remainder(pose[2] - heading, math.tau)


def _moved(line: RaceLine, index: Index, offset: Array) -> RaceLine:
    """The line with the points `index` moved to the left by `offset` (m); speeds are left alone."""
    changed = {name: getattr(line, name).copy() for name in MOVED}
    heading = line.heading[index]
    changed["x"][index] -= offset * np.sin(heading)
    changed["y"][index] += offset * np.cos(heading)
    changed["width_left"][index] -= offset
    changed["width_right"][index] += offset
    spline = CubicSpline(np.arange(len(index)), np.column_stack([changed["x"][index], changed["y"][index]]))
    (dx, dy), (ddx, ddy) = spline(np.arange(len(index)), 1).T, spline(np.arange(len(index)), 2).T
    across = np.angle(np.exp(1j * (np.arctan2(dy, dx) - heading)))
    changed["heading"][index] += across
    changed["curvature"][index] = (dx * ddy - dy * ddx) / np.hypot(dx, dy) ** 3
    uphill, left_up = np.sin(line.grade[index]), np.sin(line.bank[index])
    changed["grade"][index] = np.arcsin(np.cos(across) * uphill + np.sin(across) * left_up)
    changed["bank"][index] = np.arcsin(np.cos(across) * left_up - np.sin(across) * uphill)
    return replace(line, **changed)
