"""What never changes while a page is open: the track, the limits that are drawn, and which recording it shows."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hil_gateway.config import Config
from hil_gateway.process.arrays import Array
from hil_gateway.track.track import Track

TRACK_POINTS = 600
LANE_STEP = 5
"""m, about, between drawn points of a pit lane"""


def setup_of(
    track: Track, config: Config, recording: dict[str, Any] | None = None, limit_s: float | None = None
) -> dict[str, Any]:
    """For the page, once; `recording`: what is shown where it is not the live bus; `limit_s`: the car's lap limit."""
    return {
        "track": track_outline(track),
        "rate_hz": config.dashboard.rate_hz,
        "limits": {
            "steer_deg": _steering_limit_deg(config),
            "plan_ms": 1e3 * config.planner.deadline_s,
            "grip": 100.0,
            "latency_ms": 1e3 * config.gateway.command_latency_max_s,
        },
        "lap_limit_s": limit_s,
        "recording": recording,
    }


def _steering_limit_deg(config: Config) -> float:
    """The car's own limit at the road wheel, deg."""
    return round(math.degrees(config.car.actuators.steering_range), 2)


def track_outline(track: Track) -> dict[str, Any]:
    """Both edges of track and pit lane, m, thinned for drawing, and the boxes as x, y (m) and yaw (rad)."""
    sides = track.lane_edges()
    lane = None if sides is None else _points(dict(zip(("left", "right"), sides, strict=True)), LANE_STEP)
    boxes = () if track.pit_lane is None else track.pit_lane.boxes
    places = [[round(value, 2) for value in track.box_pose(box)] for box in boxes]
    outline = {"name": track.name, **edges(track), "pit_lane": lane, "boxes": places}
    return outline | {"length_m": round(track.length, 1)}


def edges(track: Track, inset: float = 0.0) -> dict[str, dict[str, list[float]]]:
    """`left` and `right` edge, `inset` m inside the road's, m, thinned for drawing."""
    sides = dict(zip(("left", "right"), track.edges(inset), strict=True))
    return _points(sides, max(len(track.x) // TRACK_POINTS, 1))


def _points(sides: dict[str, tuple[Array, Array]], step: int) -> dict[str, dict[str, list[float]]]:
    """Every `step`-th point of each."""
    return {
        name: {"x": np.round(x[::step], 2).tolist(), "y": np.round(y[::step], 2).tolist()}
        for name, (x, y) in sides.items()
    }
