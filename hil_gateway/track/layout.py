"""Tracks from an own compact description: straights and corners, elevation, bank.

```toml
name = "Oval"
heading_deg = 0.0            # of the first segment, from x to the left
length = 1800.0              # wanted lap length, optional
width = 12.0                 # both sides together

[[segment]]
straight = 400.0
bank_deg = 0.0               # optional, as in a corner that turns the way of the lap

[[segment]]
corner = 180.0               # change of heading, deg, positive left
radius = 150.0
transition = 60.0            # length of the spiral into and out of it, or [in, out]
bank_deg = 12.0              # inside down, positive; fades with the spiral to that of the straight beside it
width = 14.0                 # this segment only; optional, right and left: [7.0, 7.0]

[[elevation]]                # height at arc length, joined smoothly
s = 0.0
z = 0.0

[pit_lane]                   # optional: offset of its middle at arc length, m, positive left, joined smoothly
width = 8.0
points = [[-240.0, 4.0], [-150.0, 14.0], [150.0, 14.0], [240.0, 4.0]]
speed = 20.0                 # m/s, optional
limit = [-150.0, 150.0]      # where that holds, optional: while the lane is apart from the road
boxes = [[-40.0, 15.5]]      # optional: arc length and offset of a car in each, and its angle to the track, deg, if any
```

A corner is a spiral (clothoid), an arc and a spiral: its curvature is a trapezium over arc length. Headings must
add up to one turn. The lap is closed, and brought to `length`, by the smallest relative change of the straights;
a description that needs more than `STRETCH_MAX` is refused.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, ValidationError

from hil_gateway.process.arrays import Array
from hil_gateway.process.errors import InputError
from hil_gateway.process.model import Model, first_mistake
from hil_gateway.text_file import read_toml
from hil_gateway.track.pit_lane import LaneSurvey
from hil_gateway.track.smoothing import Survey
from hil_gateway.track.track import SPACING_M

LANE_STEP_M = 5.0
STRETCH_MAX = 0.35
Sides = float | tuple[float, float]


class Segment(Model):
    """A straight or a corner."""

    straight: float | None = Field(default=None, gt=0, description="m")
    corner: float | None = Field(default=None, ge=-300, le=300, description="deg, positive left")
    radius: float = Field(default=0.0, ge=0, description="m")
    transition: float | tuple[float, float] = 0.0
    bank_deg: float = Field(default=0.0, ge=-20, le=40, description="positive: inside down")
    width: Sides | None = None
    note: str = ""


class Height(Model):
    """Elevation at an arc length."""

    s: float = Field(ge=0)
    z: float


class LaneLayout(Model):
    """Pit lane."""

    width: float = Field(ge=3, le=30, description="m")
    points: tuple[tuple[float, float], ...] = Field(min_length=2, description="arc length and offset to the left, m")
    speed: float | None = Field(default=None, description="m/s")
    limit: tuple[float, float] | None = Field(default=None, description="arc length from and to where it holds, m")
    boxes: tuple[tuple[float, float] | tuple[float, float, float], ...] = Field(
        default=(), max_length=100, description="arc length and offset to the left, m, of a car in it; its angle, deg"
    )


class Layout(Model):
    """The whole description."""

    name: str
    source: str = ""
    heading_deg: float = 0.0
    length: float | None = Field(default=None, gt=0)
    width: Sides = 12.0
    segment: tuple[Segment, ...] = Field(min_length=2)
    elevation: tuple[Height, ...] = ()
    pit_lane: LaneLayout | None = None


def read_layout(path: Path) -> Survey:
    """Read a description and lay it out.

    Raises:
        InputError: unreadable, unknown key, headings that do not add up, or straights that cannot close the lap.
    """
    try:
        layout = Layout.model_validate(read_toml(path, "track description"))
    except ValidationError as error:
        raise InputError(f"{path}: {first_mistake(error)}") from None
    for number, segment in enumerate(layout.segment, start=1):
        _check(path, number, segment)
    return _lay_out(path, layout)


def _check(path: Path, number: int, segment: Segment) -> None:
    where = f"{path}: segment {number}"
    if (segment.straight is None) == (segment.corner is None):
        raise InputError(f"{where}: give either straight (m) or corner (deg)")
    if segment.corner is None:
        return
    if segment.radius <= 0:
        raise InputError(f"{where}: corner without radius (m)")
    entry, leave = _transition(segment)
    longest = 2.0 * segment.radius * math.radians(abs(segment.corner))
    if entry < 0 or leave < 0 or entry + leave > longest:
        raise InputError(f"{where}: transitions of {entry + leave:g} m exceed twice the arc, {longest:.0f} m")


def _transition(segment: Segment) -> tuple[float, float]:
    given = segment.transition
    return given if isinstance(given, tuple) else (given, given)


def _sides(width: Sides) -> tuple[float, float]:
    """Right and left width."""
    return width if isinstance(width, tuple) else (0.5 * width, 0.5 * width)


def _lay_out(path: Path, layout: Layout) -> Survey:
    turning = sum(segment.corner or 0.0 for segment in layout.segment)
    if abs(abs(turning) - 360.0) > 0.5:
        raise InputError(f"{path}: the corners turn by {turning:g} deg in all; a lap turns by 360 or -360")
    lengths = _closing_lengths(path, layout)
    curvature, bank, right, left = (np.concatenate(c) for c in zip(*_samples(layout, lengths), strict=True))
    ds = sum(lengths) / len(curvature)
    x, y = _integrate(curvature, ds, math.radians(layout.heading_deg))
    s = np.linspace(0.0, sum(lengths), len(x), endpoint=False)
    lane = None if layout.pit_lane is None else _lane(path, layout.pit_lane, x, y)
    return Survey(str(path), layout.name, x, y, left, right, _heights(layout, s, sum(lengths)), bank, lane)


def _lane(path: Path, lane: LaneLayout, x: Array, y: Array) -> LaneSurvey:
    """Points of the pit lane beside the closed line x, y of points about `SPACING_M` apart.

    Raises:
        InputError: its points are not in driving order.
    """
    from scipy.interpolate import PchipInterpolator

    at, offset = np.array(lane.points).T
    if not (np.diff(at) > 0.0).all():
        raise InputError(f"{path}: pit_lane.points are not in driving order; arc length before the line is negative")
    beside = _Beside(x, y)
    wanted = np.arange(at[0], at[-1], LANE_STEP_M)
    lane_x, lane_y, _ = beside(wanted, PchipInterpolator(at, offset)(wanted))
    half = np.full(len(wanted), 0.5 * lane.width)
    limit = None if lane.limit is None else (beside.pose(lane.limit[0]), beside.pose(lane.limit[1]))
    boxes = tuple(beside.pose(*box) for box in lane.boxes)
    return LaneSurvey(str(path), lane_x, lane_y, half, half, lane.speed, limit, boxes)


class _Beside:
    """Places beside a closed line x, y of points about `SPACING_M` apart."""

    def __init__(self, x: Array, y: Array) -> None:
        self._line = np.array([x, y])
        self._left = np.array([np.roll(y, 1) - np.roll(y, -1), np.roll(x, -1) - np.roll(x, 1)])
        self._left /= np.hypot(*self._left)
        self._s = np.concatenate([[0.0], np.cumsum(np.hypot(*(np.roll(v, -1) - v for v in (x, y))))])

    def __call__(self, s: ArrayLike, offset: ArrayLike) -> tuple[Array, Array, Array]:
        """x, y (m) and heading of the line (rad) at arc length `s`, `offset` m to its left, (k,)."""
        along = np.mod(s, self._s[-1])
        x, y, across, up = (np.interp(along, self._s, np.append(v, v[0])) for v in (*self._line, *self._left))
        return x + offset * across, y + offset * up, np.arctan2(-across, up)

    def pose(self, s: float, offset: float = 0.0, turned_deg: float = 0.0) -> tuple[float, float, float]:
        """x, y (m) and yaw (rad) of a car there, `turned_deg` against the line."""
        x, y, heading = (float(v) for v in self(s, offset))
        return x, y, heading + math.radians(turned_deg)


def _arc_length(segment: Segment) -> float:
    """A trapezium of curvature with height 1/R has the area of the turn: length = R angle + half of both spirals."""
    if segment.corner is None:
        return float(segment.straight or 0.0)
    return segment.radius * math.radians(abs(segment.corner)) + 0.5 * sum(_transition(segment))


def _curvature(segment: Segment, length: float, u: Array) -> Array:
    """Curvature at distances `u` into a segment, 1/m."""
    if segment.corner is None:
        return np.zeros_like(u)
    entry, leave = _transition(segment)
    shape = np.minimum(1.0, np.minimum(u / max(entry, 1e-9), (length - u) / max(leave, 1e-9)))
    return np.asarray(math.copysign(1.0 / segment.radius, segment.corner) * shape)


def _samples(layout: Layout, lengths: list[float]) -> list[tuple[Array, Array, Array, Array]]:
    """Curvature, bank, right and left width of every segment at the middle of equal steps of the whole lap."""
    total = sum(lengths)
    count = round(total / SPACING_M)
    middle = (np.arange(count) + 0.5) * (total / count)
    starts = np.concatenate([[0.0], np.cumsum(lengths)])
    out, segments = [], layout.segment
    for i, (segment, length, start, end) in enumerate(zip(segments, lengths, starts[:-1], starts[1:], strict=True)):
        u = middle[(middle >= start) & (middle < end)] - start
        curvature = _curvature(segment, length, u)
        beside = [_straight_bank(layout, segments[j % len(segments)]) for j in (i - 1, i, i + 1)]
        bank = _bank(segment, (beside[0], beside[2]), u / length, curvature) if segment.corner else 0 * u + beside[1]
        right, left = _sides(layout.width if segment.width is None else segment.width)
        out.append((curvature, bank, np.full_like(u, right), np.full_like(u, left)))
    return out


def _straight_bank(layout: Layout, segment: Segment) -> float:
    """Bank of a straight, rad, down to the inside of the lap; 0 for a corner."""
    turning = sum(other.corner or 0.0 for other in layout.segment)
    return 0.0 if segment.corner is not None else -math.copysign(math.radians(segment.bank_deg), turning)


def _bank(segment: Segment, beside: tuple[float, float], along: Array, curvature: Array) -> Array:
    """Bank over a corner, rad: from that of the straight before it to its own with the spiral, and so out of it."""
    own = -math.copysign(math.radians(segment.bank_deg), segment.corner or 0.0)
    outside = np.where(along < 0.5, *beside)
    return np.asarray(outside + (own - outside) * np.abs(curvature) * segment.radius)


def _integrate(curvature: Array, ds: float, heading: float) -> tuple[Array, Array]:
    """Points at the start of every step; each step is an arc, its chord exact to third order.

    What the sampling of the corners leaves open is spread evenly over the lap.
    """
    turned = heading + np.concatenate([[0.0], np.cumsum(curvature * ds)])
    drift = turned[-1] - heading - 2.0 * math.pi * round((turned[-1] - heading) / (2.0 * math.pi))
    turned = turned - drift * np.linspace(0.0, 1.0, len(turned))
    middle = 0.5 * (turned[:-1] + turned[1:])
    chord = ds * (1.0 - (curvature * ds) ** 2 / 24.0)
    x = np.concatenate([[0.0], np.cumsum(chord * np.cos(middle))])
    y = np.concatenate([[0.0], np.cumsum(chord * np.sin(middle))])
    share = np.linspace(0.0, 1.0, len(x))
    return (x - share * x[-1])[:-1], (y - share * y[-1])[:-1]


def _closing_lengths(path: Path, layout: Layout) -> list[float]:
    """Segment lengths with the straights stretched, by least relative change, until the lap closes."""
    lengths = [_arc_length(segment) for segment in layout.segment]
    straights = [i for i, segment in enumerate(layout.segment) if segment.corner is None]
    chords = _chords(layout, lengths)
    equations = [chords[:, straights]]
    targets = [-chords.sum(axis=1)]
    if layout.length is not None:
        equations.append(np.array([[lengths[i] for i in straights]]))
        targets.append(np.array([layout.length - sum(lengths)]))
    system, target = np.vstack(equations), np.concatenate(targets)
    stretch = np.linalg.lstsq(system, target, rcond=None)[0]
    worst = int(np.argmax(np.abs(stretch))) if straights else -1
    if worst < 0 or np.abs(system @ stretch - target).max() > 0.01 or abs(stretch[worst]) > STRETCH_MAX:
        which = f"straight {straights[worst] + 1} would change by {stretch[worst]:.0%}" if straights else "no straight"
        raise InputError(
            f"{path}: the lap does not close: {which} (limit {STRETCH_MAX:.0%}); correct angles or lengths"
        )
    for i, relative in zip(straights, stretch, strict=True):
        lengths[i] *= 1.0 + float(relative)
    return lengths


def _chords(layout: Layout, lengths: list[float]) -> Array:
    """Displacement over each segment, shape (2, segments), m."""
    heading, steps, chords = math.radians(layout.heading_deg), 2000, []
    for segment, length in zip(layout.segment, lengths, strict=True):
        ds = length / steps
        middle = np.linspace(0.5 * ds, length - 0.5 * ds, steps)
        curvature = _curvature(segment, length, middle)
        angle = heading + (np.cumsum(curvature) - 0.5 * curvature) * ds
        chords.append((np.cos(angle).sum() * ds, np.sin(angle).sum() * ds))
        heading += math.radians(segment.corner or 0.0)
    return np.array(chords).T


def _heights(layout: Layout, s: Array, length: float) -> Array:
    """Monotone cubic through the heights, periodic over the lap (no overshoot between them)."""
    from scipy.interpolate import PchipInterpolator

    if not layout.elevation:
        return np.zeros_like(s)
    points: list[Any] = sorted((h.s * 1.0, h.z) for h in layout.elevation)
    at = np.array([p[0] for p in points])
    z = np.array([p[1] for p in points])
    laps = [np.concatenate([at - length, at, at + length]), np.concatenate([z, z, z])]
    return np.asarray(PchipInterpolator(*laps)(s))
