"""The reference path as the optimal-control problem sees it: one cubic, limits and road angles a stage.

A cubic of the whole periodic spline has the same values and derivatives as the spline at the point where a stage
is linearised, so nothing of the track is inside the compiled functions: a new track or race line needs no new code.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.process.arrays import Array, Complex
from planner.line.raceline import OptimisedLine

WINDOW = 15
"""points of the line either side of a hint among which the nearest is sought, some 30 m"""


SPEED, ROAD_LOAD = slice(4, 6), slice(9, 12)
"""rows of the speed limit with its slope, and of the axle loads, among those of the road"""


@dataclass(frozen=True)
class ReferencePoint:
    """Reference path at positions `s`, arrays of one shape."""

    x: Array
    y: Array
    heading: Array
    curvature: Array


class Reference:
    """A race line with its speed limit on a uniform grid, addressed by unwrapped progress s (m, grows over laps)."""

    def __init__(self, line: OptimisedLine, before: Reference | None = None, least_width: float = 0.0) -> None:
        """`before`: one made before, whose path is used again where it is the same and only speeds are new.
        `least_width`: a plan may go by so much (m) to either side of the line, however near an edge is."""
        self.line, self._least_width = line, least_width
        self.length = line.length
        self._spacing = line.length / len(line.s)
        same = before if before is not None and before.line.x is line.x else None
        self._cubics: Array = same._cubics if same else _cubics(line)
        self._cubic_at: Array = same._cubic_at if same else np.ascontiguousarray(self._cubics.T)
        self._closed: Complex = same._closed if same else _lapped(line)
        self._road: Array = same._road.copy() if same else self._road_of(line)
        self._road[SPEED] = line.vx_profile, self._slope(line.vx_profile)

    def _road_of(self, line: OptimisedLine) -> Array:
        """Rows of `stages`, speeds left open."""
        left, right = (np.maximum(width, self._least_width) for width in (line.width_left, line.width_right))
        centre, half_width = 0.5 * (left - right), 0.5 * (left + right)
        rows = [centre, self._slope(centre), half_width, self._slope(half_width), *np.zeros((2, len(line.s)))]
        load = [np.cos(line.grade) * np.cos(line.bank) - 1.0, line.bend / GRAVITY, np.sin(line.bank) / GRAVITY]
        return np.vstack([*rows, line.grade, line.bank, line.track_s, *load])

    def _slope(self, values: Array) -> Array:
        """Forward difference over one cell of the closed grid."""
        return np.asarray((np.roll(values, -1) - values) / self._spacing)

    def _cell(self, s: Array) -> tuple[Array, npt.NDArray[np.intp]]:
        """Unwrapped knot position below each s, and its index on the grid."""
        number = np.floor(s / self._spacing)
        return number * self._spacing, (number % len(self.line.s)).astype(np.intp)

    def stages(self, s: Array) -> tuple[Array, Array, Array]:
        """Knots (K,), cubic coefficients of x then y by rising power (8, K), and road data (12, K) at s (K,).

        Road rows, at the knot: offset of the middle of the track from the line (m, positive left), its slope, half
        the track's width (m), its slope, speed limit (m/s), its slope (1/s), grade and bank (rad), arc length of
        the track's centre line (m), and what the road adds to the axle loads, over the weight: r0 + r1 vx^2 - r2 vx
        omega in three rows.
        """
        knot, index = self._cell(s)
        return knot, self._cubics.take(index, axis=1), self._road.take(index, axis=1)

    def road_load(self, s: float) -> list[float]:
        """What the road adds to the axle loads at s: the last three road rows of `stages`."""
        return list(self._road[ROAD_LOAD, math.floor(s / self._spacing) % len(self.line.s)].tolist())

    def at(self, s: Array) -> ReferencePoint:
        """Position, heading (rad, principal value) and curvature at s (K,)."""
        knot, index = self._cell(s)
        t = s - knot
        (x0, x1, x2, x3), (y0, y1, y2, y3) = self._cubics[:4, index], self._cubics[4:, index]
        dx, dy = x1 + t * (2 * x2 + 3 * t * x3), y1 + t * (2 * y2 + 3 * t * y3)
        ddx, ddy = 2 * x2 + 6 * t * x3, 2 * y2 + 6 * t * y3
        x, y = x0 + t * (x1 + t * (x2 + t * x3)), y0 + t * (y1 + t * (y2 + t * y3))
        return ReferencePoint(x, y, np.arctan2(dy, dx), (dx * ddy - dy * ddx) / np.hypot(dx, dy) ** 3)

    def speed_limit(self, s: Array) -> Array:
        """Speed profile at s (K,), m/s."""
        knot, index = self._cell(s)
        return np.asarray(self._road[4, index] + (s - knot) * self._road[5, index])

    def project(self, x: float, y: float, hint: float) -> float:
        """Unwrapped s of the nearest point among those within some 30 m of `hint`."""
        n, first = len(self.line.s), round(hint / self._spacing) - WINDOW
        around = self._closed[first % n : first % n + 2 * WINDOW + 1]
        return self._refine(x, y, (first + int(np.abs(around - complex(x, y)).argmin())) * self._spacing)

    def find(self, x: float, y: float, last: float = 0.0) -> float:
        """Unwrapped s of the nearest point of all, by less than half a lap from `last`: where a car was put there is no
        hint, and one that stands before the line is before its first lap."""
        s = int(np.argmin((self.line.x - x) ** 2 + (self.line.y - y) ** 2)) * self._spacing
        return self._refine(x, y, last + math.remainder(s - last, self.length))

    def _refine(self, x: float, y: float, s: float) -> float:
        """Newton steps along the tangent."""
        cell = None
        for _ in range(3):
            number = math.floor(s / self._spacing)
            if number != cell:
                cell = number
                x0, x1, x2, x3, y0, y1, y2, y3 = self._cubic_at[number % len(self.line.s)].tolist()
            t = s - number * self._spacing
            dx, dy = x1 + t * (2 * x2 + 3 * t * x3), y1 + t * (2 * y2 + 3 * t * y3)
            ahead_x, ahead_y = x - x0 - t * (x1 + t * (x2 + t * x3)), y - y0 - t * (y1 + t * (y2 + t * y3))
            along = (dx * ahead_x + dy * ahead_y) / (dx**2 + dy**2)
            s += min(max(along, -self._spacing), self._spacing)
        return s


def _lapped(line: OptimisedLine) -> Complex:
    """Points of a line as x + iy, the first ones repeated behind the last: a window of them is one piece."""
    points = line.x + 1j * line.y
    return np.concatenate([points, points[: 2 * WINDOW + 1]])


def _cubics(line: OptimisedLine) -> Array:
    """Coefficients of x then y by rising power, (8, n), of the periodic spline through the points of a line."""
    grid, points = np.append(line.s, line.length), np.column_stack([line.x, line.y])
    spline = CubicSpline(grid, np.vstack([points, points[:1]]), bc_type="periodic")
    return np.ascontiguousarray(spline.c[::-1].transpose(2, 0, 1).reshape(8, len(line.s)))
