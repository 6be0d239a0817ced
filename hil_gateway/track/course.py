"""What a course must be besides a smooth line: of a length a race track has, and without a level crossing."""

from __future__ import annotations

import numpy as np

from hil_gateway.process.arrays import Array
from hil_gateway.process.errors import InputError
from hil_gateway.track.track import Track

LENGTH_MAX_M = 60_000.0
"""the longest circuit raced today has 25 km"""
LENGTH_MIN_M, WIDTHS_MIN = 100.0, 5.0
"""and on a track of small cars at least so many of its widths"""
POINTS = 1200
"""of the line that are compared with each other: every 5 m of an ordinary track"""
BRIDGE_M = 3.0
"""difference of height with which one part passes over another"""


def check_course(source: str, track: Track) -> Track:
    """`track` itself.

    Raises:
        InputError: too long, too short, or crossing itself on the level.
    """
    shortest = min(LENGTH_MIN_M, WIDTHS_MIN * float(np.median(track.width_left + track.width_right)))
    if not shortest <= track.length <= LENGTH_MAX_M:
        raise InputError(
            f"{source}: the track is {track.length:.0f} m long (limits {shortest:.0f} to {LENGTH_MAX_M:.0f} m); "
            "are its units metres?"
        )
    if (place := _level_crossing(track)) is not None:
        x, y = place
        raise InputError(
            f"{source}: the track crosses itself near x = {x:.0f}, y = {y:.0f} m at the same height; "
            f"a bridge needs z_m that differ by {BRIDGE_M:g} m"
        )
    return track


def _level_crossing(track: Track) -> tuple[float, float] | None:
    """Where two parts of the line that do not follow each other intersect, m."""
    s = np.linspace(0.0, track.length, min(len(track.s), POINTS), endpoint=False)
    on = track.at(s)
    a = np.stack([on.x, on.y], axis=1)
    step = np.roll(a, -1, axis=0) - a
    apart = a[None, :, :] - a[:, None, :]
    turn = _cross(step[:, None, :], step[None, :, :])
    with np.errstate(divide="ignore", invalid="ignore"):
        along, across = _cross(apart, step[None, :, :]) / turn, _cross(apart, step[:, None, :]) / turn
    meet = (
        (along >= 0) & (along < 1) & (across >= 0) & (across < 1) & (np.abs(on.z[:, None] - on.z[None, :]) < BRIDGE_M)
    )
    index = np.arange(len(s))
    gap = np.abs(index[:, None] - index[None, :])
    found = np.argwhere(meet & (np.minimum(gap, len(s) - gap) > 1))
    return None if not len(found) else (float(a[found[0, 0], 0]), float(a[found[0, 0], 1]))


def _cross(a: Array, b: Array) -> Array:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
