"""A track as one self-contained HTML page: road, pit lane and boxes from above; bends, bank, height and width."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hil_gateway.dashboard.day.page import section, table, whole_page
from hil_gateway.dashboard.look import COLOURS, inline_image, new_figure, plot_style
from hil_gateway.process.arrays import Array
from hil_gateway.process.figures import figure
from hil_gateway.track.track import PitLane, Track

MAP_INCHES, LANE_INCHES, PROFILE_INCHES = (11.0, 7.0), (11.0, 4.0), (11.0, 7.0)
POSTS = 10
"""marks of arc length around the map, about"""


def page(track: Track) -> str:
    """HTML of a track."""
    parts = [section("Track", table(("", ""), _facts(track))), section("From above", _map(track))]
    if track.pit_lane is not None:
        parts += [section("Pit lane", table(("", ""), _lane_facts(track, track.pit_lane)) + _lane(track))]
    return whole_page(f"Track {track.name}", [*parts, section("Along a lap", _profiles(track))])


def _facts(track: Track) -> list[tuple[str, str]]:
    width, sense = track.width_left + track.width_right, "counter-clockwise" if track.turning > 0 else "clockwise"
    tightest = int(np.argmax(np.abs(track.curvature)))
    radius = figure(1.0 / abs(float(track.curvature[tightest])), "m", 3)
    return [
        ("length", f"{figure(track.length, 'm', 5)}, driven {sense}"),
        ("width", _range(width, "m")),
        ("tightest bend", f"{radius} at {track.s[tightest]:.0f} m"),
        ("bank into the bend", _range(np.degrees(-np.sign(track.curvature) * track.bank), "deg")),
        ("grade, up", _range(100.0 * np.tan(track.grade), "%")),
        ("height", figure(float(np.ptp(track.z)), "m", 3)),
        ("distance of the file's points from the line", figure(track.deviation, "m", 2)),
    ]


def _lane_facts(track: Track, lane: PitLane) -> list[tuple[str, str]]:
    where = [f"{s % track.length:.0f} m" for s in (lane.s[0], lane.s[-1], *lane.limit)]
    boxes = [f"{n} at {box.s % track.length:.0f} m" for n, box in enumerate(lane.boxes, start=1)]
    return [
        ("leaves the road, is back", f"{where[0]}, {where[1]}"),
        ("speed limit", f"{figure(lane.speed, 'm/s', 3)} from {where[2]} to {where[3]}"),
        ("width", _range(lane.width_left + lane.width_right, "m")),
        ("boxes", ", ".join(boxes) or "none"),
    ]


def _range(values: Array, unit: str) -> str:
    """Least and greatest, to a tenth."""
    ends = dict.fromkeys(figure(round(float(end), 1), unit, 3) for end in (values.min(), values.max()))
    return " to ".join(ends)


def _map(track: Track) -> str:
    with plot_style():
        drawn, axis = new_figure(size=MAP_INCHES)
        _ground(axis, track)
        for s in _posts(track.length):
            at = track.at(s)
            beyond = at.width_right + 0.02 * float(np.ptp(track.x) + np.ptp(track.y))
            place = at.x + beyond * math.sin(at.heading), at.y - beyond * math.cos(at.heading)
            axis.annotate(f"{s:.0f} m", place, ha="center", va="center", fontsize=8)
            axis.plot(at.x, at.y, ".", color=COLOURS["measured"], ms=4)
        _arrow(axis, track)
        return inline_image(drawn)


def _posts(length: float) -> Array:
    """Round arc lengths around the lap, m."""
    rough = length / POSTS
    decade = 10.0 ** math.floor(math.log10(rough))
    step = next(decade * part for part in (1.0, 2.0, 5.0, 10.0) if decade * part >= rough)
    return np.arange(0.0, length - 0.3 * step, step)


def _arrow(axis: Any, track: Track) -> None:
    """The line, and the way that cars go from it."""
    at, on = track.at(0.0), track.at(0.03 * track.length)
    across = -math.sin(at.heading), math.cos(at.heading)
    ends = [(at.x + e * across[0], at.y + e * across[1]) for e in (at.width_left, -at.width_right)]
    axis.plot(*zip(*ends, strict=True), color=COLOURS["before"], lw=2.5)
    axis.annotate("", (on.x, on.y), (at.x, at.y), arrowprops={"arrowstyle": "->", "color": COLOURS["before"]})


def _ground(axis: Any, track: Track) -> None:
    """Road, pit lane and boxes, to scale."""
    left, right = track.edges()
    for edge in (left, right):
        axis.plot(*(np.append(side, side[0]) for side in edge), color=COLOURS["measured"], lw=0.8)
    if (lane := track.lane_edges()) is not None:
        for edge in lane:
            axis.plot(*edge, color=COLOURS["after"], lw=0.8)
    for n, box in enumerate(track.pit_lane.boxes if track.pit_lane else (), start=1):
        x, y, _ = track.box_pose(box)
        axis.plot(x, y, "s", color=COLOURS["accent"], ms=3)
        axis.annotate(str(n), (x, y), (0, 5), textcoords="offset points", ha="center", fontsize=7)
    axis.set_aspect("equal", adjustable="datalim")
    axis.set(xlabel="x, east (m)", ylabel="y, north (m)")


def _lane(track: Track) -> str:
    """The pit lane beside the road, straightened: offset from the centre line over arc length."""
    lane = track.pit_lane
    assert lane is not None
    at = track.at(lane.s)
    with plot_style():
        drawn, axis = new_figure(size=LANE_INCHES)
        for edge in (at.width_left, -at.width_right):
            axis.plot(lane.s, edge, color=COLOURS["measured"], lw=0.8)
        axis.fill_between(lane.s, lane.right, lane.left, color=COLOURS["after"], alpha=0.25, label="pit lane")
        held = (lane.s >= lane.limit[0]) & (lane.s <= lane.limit[1])
        axis.plot(lane.s[held], lane.offset[held], "--", color=COLOURS["after"], label=f"at most {lane.speed:g} m/s")
        for n, box in enumerate(lane.boxes, start=1):
            axis.plot(box.s, box.offset, "s", color=COLOURS["accent"])
            axis.annotate(str(n), (box.s, box.offset), (0, 6), textcoords="offset points", ha="center")
        axis.set(xlabel="arc length (m)", ylabel="to the left of the centre line (m)")
        axis.legend(loc="best")
        return inline_image(drawn)


def _profiles(track: Track) -> str:
    rows = {
        "curvature, left (1/km)": (1000.0 * track.curvature,),
        "bank, left side up (deg)": (np.degrees(track.bank),),
        "height (m)": (track.z,),
        "edges, left (m)": (track.width_left, -track.width_right),
    }
    with plot_style():
        drawn, axes = new_figure(len(rows), 1, PROFILE_INCHES, sharex=True)
        for axis, (name, lines) in zip(axes, rows.items(), strict=True):
            for values in lines:
                axis.plot(track.s, values, color=COLOURS["after"])
            axis.set_title(name)
        axes[-1].set_xlabel("arc length (m)")
        return inline_image(drawn)
