"""Survey of faults: random cars, places and orders of faults, all drawn from one seed before anything is driven.

A track gets one random car, whose sensors have other noise than is declared. Every fault of the model and some pairs
are dealt to places of the first two laps, one of them in the first seconds after arming, and from every place the car
also drives on without a fault: a place from where it leaves the road or stops by itself judges no fault.
"""

from __future__ import annotations

import random
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from benchmarks.campaign.run import with_bar
from benchmarks.driving.random_car import random_car, with_other_noise
from benchmarks.faults.car_campaign import (
    NOTHING,
    SINGLE,
    TRACKS,
    FaultResult,
    Pair,
    Place,
    from_places,
    pairs,
    summary,
)
from hil_gateway.plant.car_file import SimulatedCar

ARMED_S, FAST_S, LAST_S = 2.0, 14.0, 80.0
"""s of driving: the car is armed, at speed, in its second lap"""
PLACES = 7
"""a track, the first of them before the car is at speed"""
PAIRS = 6
"""a track"""
LEAST_KEPT = 0.99
"""share of the stops that must keep to the road, or leave it by physics"""
NOISES = 1000
"""seeds of noise, more than faults a track"""


@dataclass(frozen=True)
class Survey:
    """What is driven on one track."""

    track: str
    car: int
    """seed of the random car; it learns where that is odd"""
    places: tuple[Place, ...]

    @property
    def simulated(self) -> SimulatedCar:
        """The car, with sensors whose noise is not the declared one."""
        return with_other_noise(random_car(self.car), self.car)


def draw(seed: int, number: int, track: str) -> Survey:
    """The survey of the track with this `number`."""
    rng = random.Random(NOISES * seed + number)
    deck: list[Pair] = [*SINGLE, *pairs(NOISES * seed + number, PAIRS)]
    rng.shuffle(deck)
    times_s = sorted([rng.uniform(ARMED_S, FAST_S), *(rng.uniform(FAST_S, LAST_S) for _ in range(1, PLACES))])
    dealt = [((NOTHING,), *deck[place::PLACES]) for place in range(PLACES)]
    numbered = [tuple((NOISES * place + n, pair) for n, pair in enumerate(hand)) for place, hand in enumerate(dealt)]
    return Survey(track, NOISES * seed + number, tuple(zip(times_s, numbered, strict=True)))


def run_survey(seed: int, tracks: Sequence[str] = TRACKS) -> dict[str, Any]:
    """The report of `hil verify --fault-survey`; how far it has come, and every fault that leaves the road, goes to
    standard error."""
    judged: dict[str, list[FaultResult]] = {}
    healthy: list[tuple[Survey, FaultResult]] = []
    for number, track in enumerate(tracks):
        survey = draw(seed, number, track)
        results = list(_driven(survey, f"{track}, {number + 1} of {len(tracks)}"))
        drives = {r.at_s: r for r in results if r.fault == NOTHING.name}
        healthy += [(survey, drive) for drive in drives.values()]
        judged[track] = [r for r in results if r.fault != NOTHING.name and _drives_on(drives[r.at_s])]
    return _report(judged, healthy)


def _driven(survey: Survey, name: str) -> Iterator[FaultResult]:
    """What the faults of one track come to, beside a bar; fewer than were drawn where the car stops by itself."""
    results = from_places(survey.track, survey.simulated, survey.places, learn=survey.car % 2 == 1)
    drawn = sum(len(hand) for _, hand in survey.places)
    for result in with_bar(results, drawn, lambda result: f"{name}: {result.fault}", forks=True):
        if result.margin_m < 0.0:
            print(f"{survey.track}, car {survey.car}: {result}", file=sys.stderr)
        yield result


def _drives_on(drive: FaultResult) -> bool:
    """Whether a car without a fault neither stops nor leaves the road."""
    return drive.noticed_s is None and drive.margin_m >= 0.0


def _report(judged: dict[str, list[FaultResult]], healthy: Sequence[tuple[Survey, FaultResult]]) -> dict[str, Any]:
    """Without a fault, every track, and all of them together."""
    alone = [
        f"{s.track}, car {s.car}, {r.at_s:.0f} s: {r.cause or 'off the road'}" for s, r in healthy if not _drives_on(r)
    ]
    whole = summary([result for results in judged.values() for result in results])
    false_stops = [r for _, r in healthy if r.noticed_s is not None and r.margin_unnoticed_m >= 0.0]
    return {
        "ok": whole["ok"] and not false_stops and whole["single"]["kept"] >= LEAST_KEPT,
        "without a fault": {"places": len(healthy), "false stops": len(false_stops), "judge no fault": alone},
        "tracks": {track: summary(results) for track, results in judged.items()},
        "all": whole,
    }
