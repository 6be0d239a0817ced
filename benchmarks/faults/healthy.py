"""Drives without a fault: random cars that neither the declared model nor the declared noise fits, no stop allowed.

Ten cars differ from their data sheet alone, the others have every effect of the simulated car and every two of them
beside that, dealt before anything is driven. Two of four drive in processes that are held up now and then.

What every monitor comes to is kept: how near its difference comes to its bound, and how long it holds against the time
after which it stops the car. Bounds are set by these figures.
"""

from __future__ import annotations

import math
import random
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import combinations

from benchmarks.driving.random_car import random_car, with_other_noise
from benchmarks.faults.held_up import HeldUpLoop
from hil_gateway.config import Config
from hil_gateway.gateway.decide.failsafe import TABLE
from hil_gateway.plant.physics.effects import SWITCHES
from hil_gateway.settings.gateway import PERIOD_S
from planner.simulation.loop import Loop

TRACKS = ("road_course", "oval", "tri_oval")
DRIVE_S = 120.0
"""of one car, from when it is armed"""
WITHOUT = 10
"""cars without an effect in a round"""
LEAST_SIZE = 0.5
"""of the size that campaigns give an effect, at least"""
JUDGED = (
    "position_wrong", "wheel_speed_wrong", "yaw_rate_wrong", "acceleration_wrong", "steering_stuck", "pedals_stuck",
    "commands_unanswered", "position_lost", "off_road", "wrong_way",
)  # fmt: skip
"""rows that monitors of sensors and actuators can fire"""
THRESHOLDS = {row.cause: row.threshold_s for row in TABLE if row.cause in JUDGED and row.threshold_s > 0.0}


@dataclass
class HealthyDrive:
    """What one drive came to."""

    track: str
    car: int
    effects: dict[str, float]
    seconds: float = 0.0
    stops: list[tuple[float, str, str]] = field(default_factory=list)
    """(time, action, cause)"""
    slip: float = 0.0
    """largest side slip of the simulated car in the last second, rad: a car that spins is stopped for some cause"""
    off_road: bool = False
    """a wheel left the road first, by the referee: then a stop is none without a fault"""
    shares: dict[str, float] = field(default_factory=dict)
    """monitor -> largest difference over its bound"""
    held: dict[str, float] = field(default_factory=dict)
    """cause -> longest time it held over the time after which it stops the car"""

    @property
    def false_stop(self) -> bool:
        """Stopped on the road."""
        return bool(self.stops) and not self.off_road


def deal(seed: int) -> dict[str, float]:
    """Effects of the car with this seed and their sizes: none, one or two."""
    names = sorted(SWITCHES)
    round_: list[tuple[str, ...]] = [()] * WITHOUT + [(name,) for name in names] + list(combinations(names, 2))
    random.Random(0).shuffle(round_)
    rng = random.Random(seed)
    return {name: _size(name, rng) for name in round_[seed % len(round_)]}


def _size(name: str, rng: random.Random) -> float:
    """Either way, but for a road: that is the map's, or flatter."""
    switch = SWITCHES[name]
    mirrored = switch.low < 0.0 and not name.startswith("road_") and rng.random() < 0.5
    size = (-1.0 if mirrored else 1.0) * switch.example * rng.uniform(LEAST_SIZE, 1.0)
    return min(max(size, switch.low), switch.high)


def drive(track: str, seed: int, seconds: float = DRIVE_S) -> HealthyDrive:
    """One random car on one track; every second car is learnt on the way."""
    settings = {
        "track": track,
        "plant": {"seed": seed},
        "estimator": {"learn": seed % 2 == 1},
    }
    result = HealthyDrive(track, seed, deal(seed))
    car = with_other_noise(random_car(seed), seed).model_copy(update={"effects": result.effects})
    config, held_up = Config.model_validate(settings), seed // 2 % 2 == 1
    loop = HeldUpLoop(config, seed, simulated=car) if held_up else Loop(config, simulated=car)
    slips: deque[float] = deque(maxlen=round(1.0 / PERIOD_S))
    while loop.elapsed_s < seconds + 10.0 and not result.stops:
        loop.step()
        if loop.result.armed and loop.gateway.seen is not None:
            result.off_road = result.off_road or loop.plant.referee.off_track_count > 0
            result.stops = list(loop.result.failsafes)
            _keep_largest(result.shares, loop.gateway.shares)
            measures = loop.gateway.seen[1].measures
            _keep_largest(result.held, {cause: measures[cause] / limit for cause, limit in THRESHOLDS.items()})
            slips.append(abs(math.atan2(loop.plant.car["vy"], max(loop.plant.car["vx"], 1.0))))
    result.slip = max(slips, default=0.0)
    result.seconds = loop.finish().seconds
    return result


def drives(seconds: float, tracks: Sequence[str] = TRACKS) -> Iterator[HealthyDrive]:
    """One car after the other, on the tracks (names or files) in turn, until they have driven so long in all."""
    driven, seed = 0.0, 0
    while driven < seconds:
        yield (result := drive(tracks[seed % len(tracks)], seed, min(DRIVE_S, seconds - driven)))
        driven, seed = driven + max(result.seconds, 1.0), seed + 1


def summary(results: list[HealthyDrive]) -> dict[str, object]:
    """Hours, false stops, and the largest of every figure."""
    shares: dict[str, float] = {}
    held: dict[str, float] = {}
    for result in results:
        _keep_largest(shares, result.shares)
        _keep_largest(held, result.held)
    return {
        "hours": round(sum(r.seconds for r in results) / 3600.0, 3),
        "cars": len(results),
        "false_stops": [[r.track, r.car, r.effects, *r.stops[0], round(r.slip, 3)] for r in results if r.false_stop],
        "left_the_road": sum(r.off_road for r in results),
        "largest_share_of_bound": {name: round(value, 3) for name, value in sorted(shares.items())},
        "longest_share_of_time": {name: round(value, 3) for name, value in sorted(held.items())},
    }


def _keep_largest(kept: dict[str, float], values: dict[str, float]) -> None:
    for name, value in values.items():
        kept[name] = max(kept.get(name, 0.0), value)
