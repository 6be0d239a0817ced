"""The way a stop takes: from where the car is along the track, with the least lateral force, inside the road.

In track coordinates the way is its lateral offset e over arc length s; its curvature is about k + e'' with the track's
k. Least squares over a grid: the lateral force (v^2 (k + e''))^2, where the speed v falls as the stop brakes, but not
below the slowest that is judged; its change with time, squared; the excess over a corridor that ends inside the road,
squared; and e^2, a slight pull towards the middle. A plan is no way to stop on: a racing line runs along the very edge.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solveh_banded

from hil_gateway.gateway.perceive.dead_reckoning import Pose
from hil_gateway.gateway.perceive.monitors.road import ACROSS, NEAR
from hil_gateway.observer.observer import SLOWEST
from hil_gateway.process.arrays import Array
from hil_gateway.track.track import Track, TrackPoint

STEP = 3.0
"""m between points of the way: a tenth of the tightest bend's radius"""
ROUNDS = 8
"""solutions in which points outside of the corridor are found and pushed back"""
CLEAR = 1.2
"""m between the wheels and the edge the way keeps where it can: side slip, errors of position and steering"""
CLEAR_BLIND = 2.2
"""the same where no fixes hold the pose: after 6 s in a bend under the brakes it is 1.7 m aside"""
OUTSIDE = 400.0
"""weight of 1 m outside of the corridor, (m/s2)^2: as much as 20 m/s2 of lateral acceleration"""
MIDDLE = 0.5
"""weight of 1 m off the middle, (m/s2)^2: 5 m count as 3.5 m/s2"""
BEYOND = 60.0
"""m the way is longer than braking as configured takes: bends leave less for braking"""
GIVEN = 3
"""points at the beginning of a way that are given: place, direction and curvature of the car's course"""
SMOOTH_S = 0.3
"""s in which a lateral force that changes by so much weighs as much as the force: steering acts after 0.1 s, and a car
follows it within 0.2 s"""
CLEAR_FIRST = 0.8
"""m clear of the edges where the stop begins: the pose is good to 0.2 m then, and to turn at once to where it is clear
of them takes 14 m/s2 at 70 m/s, which spins a car that oversteers under the brakes"""
CLEAR_S = 1.5
"""s after which the way keeps all of its distance: 1.4 m further in by then take 2.5 m/s2"""


@dataclass(frozen=True, slots=True)
class Path:
    """Polyline over its own arc length, local map frame, m; arrays of one length (n >= 2)."""

    x: Array
    y: Array
    s: Array
    curvature: Array
    """positive to the left, 1/m"""

    def nearest(self, x: float, y: float) -> int:
        """Vertex nearest to (x, y)."""
        return int(np.argmin((self.x - x) ** 2 + (self.y - y) ** 2))

    def ahead(self, vertex: int, distance: float) -> tuple[float, float]:
        """Point `distance` along the path from a vertex; its last point beyond the end."""
        target = self.s[vertex] + distance
        return float(np.interp(target, self.s, self.x)), float(np.interp(target, self.s, self.y))

    def distance(self, x: float, y: float) -> float:
        """From (x, y) to the polyline, m; to its ends beyond them."""
        dx, dy = np.diff(self.x), np.diff(self.y)
        along = ((x - self.x[:-1]) * dx + (y - self.y[:-1]) * dy) / (dx**2 + dy**2)
        share = np.clip(along, 0.0, 1.0)
        return float(np.hypot(self.x[:-1] + share * dx - x, self.y[:-1] + share * dy - y).min())


def polyline(points: Array) -> Path:
    """Path through `points`, shape (2, n), no two of them in one place."""
    x, y, s = *points, np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points)))])
    heading = np.unwrap(np.arctan2(np.gradient(y, s), np.gradient(x, s)))
    return Path(x, y, s, np.gradient(heading, s))


def way_along(
    track: Track, half_width: float, pose: Pose, turn_rate: float, deceleration: float, *, clear: float = CLEAR
) -> Path | None:
    """Way of a stop with `deceleration` (m/s2) from `pose`, where the car turns with `turn_rate` (rad/s), in the end
    with its wheels, `half_width` (m) beside its middle, `clear` (m) of the edges; None far from the track."""
    s0, offset = track.project(pose.x, pose.y)
    if not abs(offset) < NEAR:
        return None
    count = math.ceil((pose.speed**2 / (2 * deceleration) + BEYOND) / STEP)
    s: Array = s0 + STEP * np.arange(1.0 - GIVEN, count)
    on, gone = track.at(s), np.maximum(s - s0, 0.0)
    aside = _lane_aside(track, s, offset)
    start = _start(pose, turn_rate, offset, s[:GIVEN] - s0, on) - aside[:GIVEN]
    clearance = CLEAR_FIRST + (clear - CLEAR_FIRST) * np.minimum(gone / (CLEAR_S * max(pose.speed, SLOWEST)), 1.0)
    room = track.room(s, aside)
    corridor = (np.maximum(side - half_width - clearance, 0.0) for side in (room.right, room.left))
    speed2 = np.maximum(pose.speed**2 - 2 * deceleration * gone, SLOWEST**2)
    e = aside + _least_lateral_force(start, on.curvature + _bend(aside), speed2, *corridor)
    return polyline(np.array([on.x - e * np.sin(on.heading), on.y + e * np.cos(on.heading)]))


def _lane_aside(track: Track, s: Array, offset: float) -> Array:
    """Offset from the centre line of what the way is pulled to, m: the line itself, or the middle of the pit lane that
    the car is in, as it is at its exit beyond that."""
    lane = track.pit_lane
    if lane is None or not track.room(float(s[GIVEN - 1]), offset).in_lane:
        return np.zeros_like(s)
    along = lane.s[0] + (s[GIVEN - 1] - lane.s[0]) % track.length + s - s[GIVEN - 1]
    return np.asarray(np.interp(along, lane.s, lane.offset))


def _bend(aside: Array) -> Array:
    """Curvature of an offset (n,) in steps of `STEP`, 1/m."""
    return np.asarray(np.gradient(np.gradient(aside, STEP), STEP))


def _start(pose: Pose, turn_rate: float, offset: float, s: Array, on: TrackPoint) -> Array:
    """Offsets of the way's first points, where it is `s` (m) behind the car: its place, direction and curvature."""
    against = math.remainder(pose.yaw + pose.slip - float(on.heading[GIVEN - 1]), math.tau)
    slope = math.tan(max(-ACROSS, min(against, ACROSS)))  # more is a wrong heading
    bend = turn_rate / max(pose.speed, SLOWEST) - float(on.curvature[GIVEN - 1])
    return np.asarray(offset + slope * s + 0.5 * bend * s**2)


def _least_lateral_force(start: Array, curvature: Array, speed2: Array, right: Array, left: Array) -> Array:
    """Offsets (n,) that begin with the `GIVEN` ones of `start`."""
    n = len(curvature)
    force = speed2[1:-1] / STEP**2 * np.array([[1.0], [-2.0], [1.0]])
    track = speed2[1:-1] * curvature[1:-1]
    change = SMOOTH_S * np.sqrt(speed2[1:-2]) / STEP
    none = np.zeros(n - 3)
    jerk = change * (np.array([none, *force[:, 1:]]) - np.array([*force[:, :-1], none]))
    bending = _gram(force, n) + _gram(jerk, n)
    aside = _scattered(force * track, n) + _scattered(jerk * (change * np.diff(track)), n)
    outside, target = np.zeros(n), np.zeros(n)
    e = target
    for _ in range(ROUNDS):
        e = _solve(bending, aside, start, outside, target)
        target = np.clip(e, -right, left)
        beyond = np.where(e != target, OUTSIDE, 0.0)
        if (beyond == outside).all():
            break
        outside = beyond
    return e


def _gram(rows: Array, n: int) -> Array:
    """B' B of a matrix B whose row i has the values rows[:, i] from column i on; upper bands (4, n) in the layout of
    `solveh_banded`."""
    bands = np.zeros((4, n))
    count = rows.shape[1]
    for first, a in enumerate(rows):
        for second, b in enumerate(rows[first:], first):
            bands[3 - (second - first), second : second + count] += a * b
    return bands


def _scattered(rows: Array, n: int) -> Array:
    """B' 1 of such a matrix."""
    out = np.zeros(n)
    for first, row in enumerate(rows):
        out[first : first + len(row)] += row
    return out


def _solve(bending: Array, aside: Array, start: Array, outside: Array, target: Array) -> Array:
    """Offsets that minimise bending, excess and distance from the middle; those of `start` are given."""
    bands = bending.copy()
    bands[3] += MIDDLE + outside
    right = outside * target - aside
    for behind in range(1, 4):
        given = np.arange(max(GIVEN - behind, 0), GIVEN)
        right[given + behind] -= bands[3 - behind, given + behind] * start[given]
    return np.concatenate([start, solveh_banded(bands[:, GIVEN:], right[GIVEN:])])
