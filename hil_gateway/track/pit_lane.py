"""A pit lane: the way beside the road between where it leaves the road and where it is back.

Seen from the track: offset of its middle from the centre line, and widths, over arc length. Its surface is taken to go
on from the road's: the same grade and bank beside each point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hil_gateway.process.arrays import Array
from hil_gateway.process.errors import InputError
from hil_gateway.track.track import PitLane, Track

STEP_M = 1.0
LONGEST = 0.5
"""of the lap"""


@dataclass(frozen=True)
class LaneSurvey:
    """Points of a lane as a file gives them, in driving order: map, m; arrays (n,); `source` names the file."""

    source: str
    x: Array
    y: Array
    width_left: Array
    width_right: Array


def lane_along(track: Track, survey: LaneSurvey) -> PitLane:
    """The lane beside a track.

    Raises:
        InputError: it runs against the track, is too long for a pit lane, or does not touch the road at an end.
    """
    from scipy.interpolate import PchipInterpolator

    s, offset = _beside(track, survey)
    if not (len(s) > 1 and (np.diff(s) > 0.0).all()):
        raise InputError(f"{survey.source}: the pit lane does not run along the track; its points are in driving order")
    if (length := s[-1] - s[0]) > LONGEST * track.length:
        raise InputError(f"{survey.source}: the pit lane is {length:.0f} m long, of a lap of {track.length:.0f} m")
    grid = np.linspace(s[0], s[-1], max(2, round((s[-1] - s[0]) / STEP_M)))
    rows = PchipInterpolator(s, np.vstack([offset, survey.width_left, survey.width_right]), axis=1)(grid)
    lane = PitLane(grid, *rows)
    for end, name in ((0, "entry"), (-1, "exit")):
        _check_end(track, lane, end, f"{survey.source}: the pit lane's {name}")
    return lane


def _beside(track: Track, survey: LaneSurvey) -> tuple[Array, Array]:
    """Arc length, unwrapped from the first point on, and offset to the left of every point, m."""
    found = [track.project(survey.x[0], survey.y[0])]
    for x, y in zip(survey.x[1:].tolist(), survey.y[1:].tolist(), strict=True):
        found.append(track.project(x, y))
    s, offset = np.array(found).T
    return np.unwrap(s, period=track.length), offset


def _check_end(track: Track, lane: PitLane, end: int, what: str) -> None:
    at = track.at(float(lane.s[end]))
    gap = max(lane.right[end] - at.width_left, -at.width_right - lane.left[end])
    if gap > 0.0:
        raise InputError(f"{what} is {gap:.1f} m from the road; a lane begins and ends where it touches the road")
