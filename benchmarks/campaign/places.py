"""Driving off from drawn places and headings, all processes on the virtual clock, judged by the plant.

Kept is a place where the car is under way within 2 s of arming, or where it was not armed or was stopped with a cause.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from hil_gateway.bus import topics
from hil_gateway.bus.messages import GatewayStatus
from hil_gateway.config import Config
from hil_gateway.plant.referee.referee import HALF_WIDTH_M
from hil_gateway.track.loading import load_track
from planner.simulation.loop import Loop

IN_LANE = 0.25
"""share of places that lie in the pit lane"""
MOST_TURNED = math.radians(50.0)
EDGE_M = 1.0
"""from the car's middle to the edge: its wheels stand on the road"""
WITHIN_S, UNDER_WAY = 2.0, 0.5
"""the promise, s; m/s by the plant that count as under way"""
READY_S = 12.0
"""from the start of all processes, in which the car is armed where it ever is"""
DRIVEN_S = 6.0
SLACK_M = 0.3
"""what the estimate of a car that has just begun to move may be wrong by"""


@dataclass(frozen=True)
class Place:
    """Where a car stands: track, arc length and offset to the left of the centre line, m, angle to the track, rad."""

    track: str
    s: float
    lateral: float
    turned: float


@dataclass(frozen=True)
class Outcome:
    """What became of a place: seconds from arming to `UNDER_WAY` (None: never), the reason that was said, and the least
    distance of a wheel to the edge, m, from `begun` on."""

    place: Place
    armed: bool
    moved_after_s: float | None
    reason: str
    begun_m: float
    worst_m: float

    @property
    def kept(self) -> bool:
        """Whether the promise is kept."""
        in_time = self.moved_after_s is not None and self.moved_after_s <= WITHIN_S
        return in_time or bool(self.reason)

    @property
    def left_the_road(self) -> bool:
        """Whether a wheel came further beyond the edge than it stood at first, by more than `SLACK_M`."""
        return self.worst_m < min(self.begun_m - HALF_WIDTH_M, 0.0) - SLACK_M

    def as_json(self) -> dict[str, Any]:
        """For the report."""
        return {**asdict(self), "kept": self.kept}


def drawn(seed: int, tracks: Sequence[str]) -> Iterator[Place]:
    """Places without end; one seed, one row of them."""
    rng = np.random.default_rng([39, seed])
    while True:
        name = tracks[int(rng.integers(len(tracks)))]
        track, lane = load_track(name), load_track(name).pit_lane
        s, turned = float(rng.uniform(0.0, track.length)), float(rng.uniform(-MOST_TURNED, MOST_TURNED))
        at = track.at(s)
        low, high = EDGE_M - at.width_right, at.width_left - EDGE_M
        if lane is not None and rng.random() < IN_LANE:
            s = float(rng.uniform(lane.s[0], lane.s[-1]))
            low, high = (float(np.interp(s, lane.s, edge)) for edge in (lane.right, lane.left))
            low, high = low + EDGE_M, high - EDGE_M
        yield Place(name, s % track.length, float(rng.uniform(low, high)), turned)


def trial(place: Place) -> Outcome:
    """Set the car down, start everything, arm when nothing is missing, drive for `DRIVEN_S`."""
    loop = Loop(Config().model_copy(update={"track": place.track}))
    statuses = loop.bus.subscribe(topics.GATEWAY_STATUS)
    car = loop.plant.car
    car.place(place.s, lateral=place.lateral, turned=place.turned)
    begun_m = car.road.track.inside(place.s, place.lateral)
    moved_s: float | None = None
    newest: GatewayStatus | None = None
    while loop.elapsed_s < READY_S or (loop.result.armed and _since_armed_s(loop) < DRIVEN_S):
        loop.step()
        polled = statuses.poll(loop.clock.now_ns())
        newest = polled[-1] if polled else newest
        if loop.result.armed and moved_s is None and car["vx"] > UNDER_WAY:
            moved_s = round(_since_armed_s(loop), 2)
    result = loop.finish()
    return Outcome(place, result.armed, moved_s, _reason(newest), begun_m, result.worst_margin_m)


def _since_armed_s(loop: Loop) -> float:
    return loop.finish().seconds


def _reason(status: GatewayStatus | None) -> str:
    """Why the car is not driven at the end, as the gateway says it."""
    if status is None:
        return ""
    missing = status.missing_for_arming
    return status.cause or ", ".join(status.advice.get(name, name) for name in missing)
