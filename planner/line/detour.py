"""A race line that goes another way for a stretch, on the same grid: progress means the same on both."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

from hil_gateway.process.arrays import Array
from hil_gateway.track.track import Room, Track
from planner.line.raceline import OptimisedLine

GENTLE = 5.0
"""m/s2, along and across: half of what dry tyres hold"""
OPENING = 0.3
"""m a metre by which the room beside a way grows where road and pit lane meet"""
SLIGHT = 1e-6
"""of a curvature, 1/m, or its slope: none"""
MOVED = ("x", "y", "heading", "curvature", "width_left", "width_right", "grade", "bank")
"""what of a race line is another beside it"""

Index = npt.NDArray[np.intp]


@dataclass(frozen=True)
class Detour:
    """A line with points that are not the race line's: `index` their numbers in the order of driving, `step` the
    distance to the next one, m, `fastest` the speed there by itself, m/s, (n,); braked for with `braking`, m/s2."""

    line: OptimisedLine
    index: Index
    step: Array
    fastest: Array
    braking: float = GENTLE

    def on(self, race_line: OptimisedLine) -> OptimisedLine:
        """It with the speeds of a race line of the same path, no faster than its own; braked for before it, too."""
        v, n = race_line.vx_profile.copy(), len(race_line.s)
        v[self.index] = np.minimum(v[self.index], self.fastest)
        spacing, first = race_line.length / n, int(self.index[0])
        step = np.concatenate([np.full(n - len(self.index), spacing), self.step])
        for i in range(n - 1, -1, -1):
            at = (first + len(self.index) + i) % n
            most = math.sqrt(v[(at + 1) % n] ** 2 + 2.0 * self.braking * step[i])
            if v[at] <= most and i < n - len(self.index):
                break
            v[at] = min(v[at], most)
        return replace(self.line, vx_profile=v)


def detour(line: OptimisedLine, index: Index, x: Array, y: Array, room: Room) -> Detour:
    """`line` with its points `index` at x, y (m), where they have `room`."""
    moved = _moved(line, index, x, y, room)
    step = np.hypot(*(np.diff(row[[*index, (index[-1] + 1) % len(line.s)]]) for row in (moved.x, moved.y)))
    return Detour(moved, index, step, np.sqrt(GENTLE / np.maximum(np.abs(moved.curvature[index]), SLIGHT)))


def steered(way: Detour, bend_rate: float) -> Detour:
    """Slow enough for steering that changes curvature by `bend_rate`, 1/(m s)."""
    change = np.abs(np.gradient(way.line.curvature[way.index])) / way.step
    return replace(way, fastest=np.minimum(way.fastest, bend_rate / np.maximum(change, SLIGHT)))


def aside(track: Track, line: OptimisedLine) -> Array:
    """Offset of a line to the left of the centre line, m, (n,)."""
    at = track.at(line.track_s)
    return np.asarray(np.cos(at.heading) * (line.y - at.y) - np.sin(at.heading) * (line.x - at.x))


def opening(width: Array, spacing: float, first: int = 0) -> Array:
    """Widths (n,) at points `spacing` m apart that change by `OPENING` at most: what opens suddenly opens gradually, so
    that between points it is what it is at them. Those before the `first` are as that: there is no way."""
    slope = OPENING * spacing * np.arange(len(width))
    width = np.concatenate([np.full(first, width[first]), width[first:]])
    for way in (1, -1):
        width = (np.minimum.accumulate(width[::way] - slope) + slope)[::way]
    return width


def _moved(line: OptimisedLine, index: Index, x: Array, y: Array, room: Room) -> OptimisedLine:
    changed = {name: getattr(line, name).copy() for name in MOVED}
    heading = line.heading[index]
    changed["x"][index], changed["y"][index] = x, y
    changed["width_left"][index], changed["width_right"][index] = room.left, room.right
    spline = CubicSpline(np.arange(len(index)), np.column_stack([x, y]))
    (dx, dy), (ddx, ddy) = spline(np.arange(len(index)), 1).T, spline(np.arange(len(index)), 2).T
    across = np.angle(np.exp(1j * (np.arctan2(dy, dx) - heading)))
    changed["heading"][index] += across
    changed["curvature"][index] = (dx * ddy - dy * ddx) / np.hypot(dx, dy) ** 3
    uphill, left_up = np.sin(line.grade[index]), np.sin(line.bank[index])
    changed["grade"][index] = np.arcsin(np.cos(across) * uphill + np.sin(across) * left_up)
    changed["bank"][index] = np.arcsin(np.cos(across) * left_up - np.sin(across) * uphill)
    return replace(line, **changed)
