"""A pit lane: the way beside the road between where it leaves the road and where it is back.

Seen from the track: offset of its middle from the centre line, and widths, over arc length. Its surface is taken to go
on from the road's: the same grade and bank beside each point.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from hil_gateway.process.arrays import Array
from hil_gateway.process.errors import InputError
from hil_gateway.track.track import SPACING_M, Box, PitLane, Track

LONGEST = 0.5
"""of the lap"""
DEFAULT_SPEED = 20.0
"""m/s where the file names none: 45 mph, what short ovals post"""
SPEED_RANGE = 3.0, 40.0
"""m/s; the fastest pit lanes raced today are driven at 100 km/h"""
MOST_TURNED = math.radians(30.0)
"""of a box against the track: a car drives into it forwards, and on"""


Place = tuple[float, float, float]


@dataclass(frozen=True)
class LaneSurvey:
    """A lane as a file gives it, in driving order: map, m; arrays (n,); `source` names the file. `speed` m/s or None,
    `limit` the places where it begins and ends to hold, or None; places and `boxes` as x, y and yaw (rad)."""

    source: str
    x: Array
    y: Array
    width_left: Array
    width_right: Array
    speed: float | None = None
    limit: tuple[Place, Place] | None = None
    boxes: tuple[Place, ...] = ()


def lane_along(track: Track, survey: LaneSurvey) -> PitLane:
    """The lane beside a track.

    Raises:
        InputError: it runs against the track, is too long for a pit lane, does not touch the road at an end, or where
            its speed limit holds or a box lies is not in it.
    """
    from scipy.interpolate import PchipInterpolator

    s, offset = _projected(track, survey.x, survey.y)
    if not (len(s) > 1 and (np.diff(s) > 0.0).all()):
        raise InputError(f"{survey.source}: the pit lane does not run along the track; its points are in driving order")
    if (length := s[-1] - s[0]) > LONGEST * track.length:
        raise InputError(f"{survey.source}: the pit lane is {length:.0f} m long, of a lap of {track.length:.0f} m")
    grid = np.linspace(s[0], s[-1], max(2, round((s[-1] - s[0]) / SPACING_M)))
    middle, left, right = PchipInterpolator(s, [offset, survey.width_left, survey.width_right], axis=1)(grid)
    speed = DEFAULT_SPEED if survey.speed is None else survey.speed
    lane = PitLane(grid, middle, left, right, speed, (float(s[0]), float(s[-1])))
    for end, name in ((0, "entry"), (-1, "exit")):
        _check_end(track, lane, end, f"{survey.source}: the pit lane's {name}")
    return replace(lane, limit=_limit(track, lane, survey), boxes=_boxes(track, lane, survey))


def _projected(track: Track, x: Array, y: Array) -> tuple[Array, Array]:
    """Arc length, unwrapped from the first point on, and offset to the left of every point, m."""
    s, offset = np.array([track.project(*point) for point in zip(x.tolist(), y.tolist(), strict=True)]).T
    return np.unwrap(s, period=track.length), offset


def _check_end(track: Track, lane: PitLane, end: int, what: str) -> None:
    at = track.at(float(lane.s[end]))
    gap = max(lane.right[end] - at.width_left, -at.width_right - lane.left[end])
    if gap > 0.0:
        raise InputError(f"{what} is {gap:.1f} m from the road; a lane begins and ends where it touches the road")


def _limit(track: Track, lane: PitLane, survey: LaneSurvey) -> tuple[float, float]:
    """Where the speed limit holds; where the file does not say, while the lane is apart from the road."""
    low, high = SPEED_RANGE
    if not low <= lane.speed <= high:
        raise InputError(f"{survey.source}: pit speed {lane.speed:g} m/s is outside {low:g} to {high:g}; in m/s?")
    if survey.limit is None:
        apart = lane.s[replace(track, pit_lane=lane).room(lane.s, lane.offset).in_lane]
        if not len(apart):
            raise InputError(f"{survey.source}: the pit lane is nowhere apart from the road; it is part of the road")
        return float(apart[0]), float(apart[-1])
    begin, end = (float(lane.along(track.project(x, y)[0], track.length)) for x, y, _ in survey.limit)
    if not begin < end <= lane.s[-1]:
        raise InputError(
            f"{survey.source}: the pit speed holds from {begin - lane.s[0]:.0f} to {end - lane.s[0]:.0f} m behind the"
            f" entry of a lane of {lane.s[-1] - lane.s[0]:.0f} m; both are in the lane, in driving order"
        )
    return begin, end


def _boxes(track: Track, lane: PitLane, survey: LaneSurvey) -> tuple[Box, ...]:
    """Each beside the track."""
    found = []
    for number, (x, y, yaw) in enumerate(survey.boxes, 1):
        where = f"{survey.source}: box {number}"
        s, offset = track.project(x, y)
        across = math.remainder(yaw - float(track.at(s).heading), math.tau)
        box = Box(float(lane.along(s, track.length)), offset, across)
        if not lane.limit[0] <= box.s <= lane.limit[1]:
            raise InputError(
                f"{where} is at {s:.0f} m along the track; boxes are where the pit speed holds,"
                f" from {lane.limit[0] % track.length:.0f} to {lane.limit[1] % track.length:.0f} m"
            )
        left, right = (float(np.interp(box.s, lane.s, edge)) for edge in (lane.left, lane.right))
        if (out := max(box.offset - left, right - box.offset)) > 0.0:
            raise InputError(f"{where} is {out:.1f} m beside the pit lane; the lane's width holds its boxes, too")
        if abs(box.across) > MOST_TURNED:
            raise InputError(
                f"{where} is turned by {math.degrees(box.across):.0f} degrees against the track"
                f" (limit {math.degrees(MOST_TURNED):.0f}); a heading is measured in the map, from x to the left"
            )
        found.append(box)
    return tuple(found)
