"""A drift of the position fixes has two witnesses: race control's receivers, without corrections and late."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import pytest

from hil_gateway.config import Config
from hil_gateway.gateway.perceive.duration import CONTRADICTED_S
from hil_gateway.gateway.perceive.monitors.receivers import OtherReceivers
from hil_gateway.gateway.perceive.positions.fixes import Fixes
from hil_gateway.plant.controller.sensors import Noise, StandaloneReceiver
from hil_gateway.process.clock import NS_PER_S

CAR, ORIGIN = Config().car, Config().origin
FAST, TIGHT = (60.0, 300.0), (15.0, 25.0)
"""m/s, and m of radius"""
BOTH = ("marelli", "mylaps")
FIX_NS = NS_PER_S // 20


@dataclass
class Reports:
    """What the gateway has received."""

    fixes: Fixes = field(default_factory=lambda: Fixes(0.02))
    values: dict[str, float] = field(default_factory=dict)
    stamps: dict[str, int] = field(default_factory=dict)

    def value(self, quantity: str) -> float:
        return self.values[quantity]

    def read(self, receiver: str, position: tuple[float, float]) -> None:
        self.values |= zip((f"receiver.{receiver}.{n}" for n in ("latitude", "longitude")), position, strict=True)

    def age_s(self, source: str, now_ns: int) -> float:
        name = source.removeprefix("receiver.")
        return (now_ns - self.stamps[name]) / NS_PER_S if name in self.stamps else math.inf


def noticed_s(
    seconds: float,
    drift: float,
    heard: tuple[str, ...],
    seed: int = 1,
    *,
    bend: tuple[float, float] = FAST,
    lost_s: float = math.inf,
    along: float = 0.0,
    asleep_s: float = 0.0,
    second_from_s: float = 0.0,
    stands_s: float = 5.0,
    waits_every: float = math.inf,
) -> float | None:
    """Time until a drift outwards and `along` the way (m/s), which begins half way, is noticed in laps of a circle;
    None: never.

    From `lost_s` on the receivers repeat their last reading. A fifth of the way through, gateway and car sleep for
    `asleep_s`. The second of them is heard from `second_from_s` on. The car stands for `stands_s` at first. One of so
    many readings waits for 0.1 s.
    """
    at_speed, radius = bend
    noise, place = Noise(seed), {"x": radius, "y": 0.0}
    receivers = {name: StandaloneReceiver(place, ORIGIN, noise) for name in heard}
    reports, others, way = Reports(), OtherReceivers(CAR, ORIGIN), 0.0
    for tick in range(round(20 * seconds)):
        now_ns, speed = tick * FIX_NS, min(max(0.5 * (tick - 20 * stands_s), 0.0), at_speed)
        now_ns += round(asleep_s * NS_PER_S) if tick > 4 * seconds else 0
        way += 0.05 * speed / radius
        place["x"], place["y"] = radius * math.cos(way), radius * math.sin(way)
        since_s = max(0.05 * tick - 0.5 * seconds, 0.0)
        cos, sin = math.cos(way), math.sin(way)
        off, on = drift * since_s + 0.02 * noise(), along * since_s + 0.02 * noise()
        east, north = off * cos - on * sin, off * sin + on * cos
        reports.fixes.take(place["x"] + east, place["y"] + north, now_ns)
        if tick and tick % waits_every == 0:
            place["x"], place["y"] = (radius * turn(way - 0.1 * speed / radius) for turn in (math.cos, math.sin))
        for name in heard if tick % 2 == 0 else ():
            if name == BOTH[1] and 0.05 * tick < second_from_s:
                continue
            if 0.05 * tick < lost_s:
                reports.read(name, receivers[name].position())
            reports.stamps[name] = now_ns
        for _ in range(5):  # at 100 Hz
            held_s = others.step(now_ns, reports)
            now_ns += FIX_NS // 5
        if held_s > CONTRADICTED_S:
            return since_s
    return None


@pytest.mark.parametrize("seed", range(12))
def test_a_car_that_has_stood_for_long_drives_off_without_a_drift(seed: int) -> None:
    """Noise of the fixes of a car that stands says nothing of how late receivers are."""
    assert noticed_s(110.0, 0.0, BOTH, seed, stands_s=95.0) is None


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(("outwards", "along"), [(0.5, 0.0), (-0.5, 0.0), (0.0, 0.5), (0.35, -0.35)])
def test_a_drift_of_half_a_metre_a_second_is_noticed_within_3_s(seed: int, outwards: float, along: float) -> None:
    since_s = noticed_s(60.0, outwards, BOTH, seed, along=along)
    assert since_s is not None and 0.0 < since_s < 3.0


@pytest.mark.parametrize("seed", range(3))
def test_a_drift_is_noticed_although_a_reading_in_a_second_has_waited(seed: int) -> None:
    since_s = noticed_s(60.0, 0.5, BOTH, seed, waits_every=20)
    assert since_s is not None and 0.0 < since_s < 3.5


@pytest.mark.parametrize("seed", range(3))
def test_a_drift_right_after_a_car_stood_for_five_seconds_is_noticed_too(seed: int) -> None:
    since_s = noticed_s(10.0, 0.5, BOTH, seed, bend=TIGHT)
    assert since_s is not None and 0.0 < since_s < 3.5


@pytest.mark.parametrize("seed", range(3))
def test_receivers_that_wander_blame_no_fix(seed: int) -> None:
    assert noticed_s(300.0, 0.0, BOTH, seed) is None


@pytest.mark.parametrize("asleep_s", [1.5, 5.0])
def test_what_was_under_way_when_gateway_and_car_slept_blames_no_fix(asleep_s: float) -> None:
    assert noticed_s(40.0, 0.0, BOTH, asleep_s=asleep_s) is None


def test_a_receiver_that_is_heard_later_blames_no_fix_by_its_first_reading() -> None:
    assert noticed_s(40.0, 0.0, BOTH, second_from_s=12.0) is None


def test_one_receiver_alone_blames_no_fix() -> None:
    assert noticed_s(60.0, 0.5, BOTH[:1]) is None


@pytest.mark.parametrize("bend", [FAST, TIGHT])
@pytest.mark.parametrize("lost_s", [2.0, 5.5, 40.0])
def test_receivers_that_hang_blame_no_fix(lost_s: float, bend: tuple[float, float]) -> None:
    assert noticed_s(100.0, 0.0, BOTH, bend=bend, lost_s=lost_s) is None


def first_braking(seed: int) -> float:
    """Largest share of the bound on a straight: 14 s of acceleration to 67 m/s, and 5 s of braking."""
    noise, place = Noise(seed), {"x": 0.0, "y": 0.0}
    receivers = {name: StandaloneReceiver(place, ORIGIN, noise) for name in BOTH}
    reports, others, speed, largest = Reports(), OtherReceivers(CAR, ORIGIN), 0.0, 0.0
    for tick in range(20 * 22):
        now_ns, t = tick * FIX_NS, 0.05 * tick
        speed = max(speed + 0.05 * (0.0 if t < 3.0 else 4.8 if t < 17.0 else -10.0), 0.0)
        place["x"] += 0.05 * speed
        reports.fixes.take(place["x"] + 0.02 * noise(), 0.02 * noise(), now_ns)
        for name in BOTH if tick % 2 == 0 else ():
            reports.read(name, receivers[name].position())
            reports.stamps[name] = now_ns
        others.step(now_ns, reports)
        largest = max(largest, others.share)
    return largest


def test_a_lateness_that_the_first_braking_only_shows_blames_no_fix() -> None:
    """Where the car has only gained speed, an offset and a lateness look alike: 10 ms of it are 0.3 m by then."""
    assert max(first_braking(seed) for seed in range(40)) < 0.8
