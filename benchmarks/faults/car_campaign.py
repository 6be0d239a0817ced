"""Single faults of the car from many places at speed: noticed, when, and whether the stop keeps to the road."""

from __future__ import annotations

import math
import random
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

from benchmarks.faults.best_stop import Best, best_stop, in_a_copy
from benchmarks.faults.car_fault_injection import SimulatedFault
from benchmarks.faults.car_faults import CAR_FAULTS, CarFault
from hil_gateway.bus.messages import FailsafeAction
from hil_gateway.config import Config
from hil_gateway.plant.car_file import SimulatedCar
from planner.simulation.loop import Loop

WATCHED_S = 8.0
"""without a stop for so long the fault has done no harm here"""
STANDS_WITHIN_S = 25.0
THEN = ", then "
"""between the names of a pair"""
TRACKS = ("road_course", "oval", "tri_oval")
SPACING_S = 7.0
"""between two places; the shortest lap takes 40 s"""
PAIRS_PER_FAULT_RUN = 4
"""pairs a place"""
SECOND_AFTER_S = 1.0
"""from the beginning of a stop to the second fault of a pair"""
PHYSICS = "physics"
"""no stop keeps the car on the road, not even one from the first effect of the fault on by the true state"""
UNNOTICED = "unnoticed"
"""a stop would have kept it on the road, and none began"""
LATE = "late"
"""none of those that begin when the fault is noticed"""
STOP = "stop"
"""one of those would have, but not the gateway's"""


Pair = tuple[CarFault, ...]
"""one fault, or one and another that begins during the stop"""
SINGLE: tuple[Pair, ...] = tuple((fault,) for fault in CAR_FAULTS)
Place = tuple[float, tuple[tuple[int, Pair], ...]]
"""s of driving, and the faults from there on, each with the seed of its noise"""
NOTHING = CarFault("no fault", (), (), math.inf, "")


@dataclass(frozen=True)
class FaultResult:
    """What one fault came to."""

    fault: str
    at_s: float
    speed: float
    noticed_s: float | None
    cause: str
    stands: bool
    margin_m: float
    """least distance of a wheel to the edge from the fault on, by the referee; negative: off the road"""
    margin_unnoticed_m: float
    """the same until the stop began"""
    why: str = ""
    """why it left the road; empty where it did not"""
    best: str = ""
    """the stop that would have kept it there, where there is one"""

    @property
    def pair(self) -> bool:
        """Of two faults."""
        return THEN in self.fault

    @property
    def harmful(self) -> bool:
        """Off the road with nobody having noticed."""
        return self.noticed_s is None and self.margin_m < 0.0


def pairs(seed: int, count: int) -> list[Pair]:
    """Faults that stop the car, each with one of other sensors during the stop."""
    rng = random.Random(seed)
    stopping = [fault for fault in CAR_FAULTS if fault.noticed_by]
    sensors = [fault for fault in stopping if fault.messages]
    drawn: list[Pair] = []
    while len(drawn) < count:
        first, second = rng.choice(stopping), rng.choice(sensors)
        if not set(first.messages) & set(second.messages):
            drawn.append((first, second))
    return drawn


@dataclass
class Run:
    """One fault, or a pair of them, from the loop's present state on; each method needs a copy of the loop."""

    loop: Loop
    config: Config
    injector: SimulatedFault
    faults: Pair = ()
    seed: int = 0

    def simulate(self) -> dict[str, Any]:
        """A `FaultResult`, until the car stands, or nothing has happened for `WATCHED_S`."""
        loop, referee = self.loop, self.loop.plant.referee
        begin_s, speed = loop.elapsed_s, loop.plant.car["vx"]
        waiting = list(self.faults)
        referee.worst_margin_m = math.inf
        self._begin(waiting.pop(0))
        noticed_s, before = None, math.inf
        while loop.elapsed_s < begin_s + STANDS_WITHIN_S and not loop.plant.car.standing:
            loop.step()
            since_s = loop.elapsed_s - begin_s
            if noticed_s is None and self._stopping:
                noticed_s, before = since_s, referee.worst_margin_m
            if noticed_s is None and since_s > WATCHED_S:
                break
            if waiting and noticed_s is not None and since_s > noticed_s + SECOND_AFTER_S:
                self._begin(waiting.pop(0))
        standing, cause = bool(loop.plant.car.standing), loop.gateway.failsafe.cause
        name = THEN.join(fault.name for fault in self.faults)
        margin = referee.worst_margin_m
        return asdict(FaultResult(name, begin_s, speed, noticed_s, cause, standing, margin, before))

    def stopped(self, at_s: float) -> FaultResult:
        """Of a loop that has stopped by itself."""
        loop = self.loop
        cause, margin = loop.gateway.failsafe.cause, loop.plant.referee.worst_margin_m
        return FaultResult(NOTHING.name, at_s, loop.plant.car["vx"], 0.0, cause, False, margin, margin)

    def noticed(self, fault: CarFault, within_s: float) -> tuple[float | None, str]:
        """When and why a stop begins, None where none does within the time."""
        loop, end_s = self.loop, self.loop.elapsed_s + within_s
        self._begin(fault)
        while loop.elapsed_s < end_s and not self._stopping:
            loop.step()
        after_s = loop.elapsed_s - end_s + within_s
        return (after_s, loop.gateway.failsafe.cause) if self._stopping else (None, "")

    def why_off(self, result: FaultResult) -> dict[str, str]:
        """Why the car of `result` left the road, by the plant alone, and the stop that would not have."""
        self._begin(self.faults[0])
        while not self.injector.shows and not self._stopping:
            self.loop.step()
        best = self._best_stop()
        if best.margin_m < 0.0:
            return {"why": PHYSICS}
        if result.noticed_s is None:
            return {"why": UNNOTICED, "best": best.stop}
        while not self._stopping:
            self.loop.step()
        from_then_on = self._best_stop()
        if result.margin_unnoticed_m >= 0.0 and from_then_on.margin_m >= 0.0:
            return {"why": STOP, "best": from_then_on.stop}
        return {"why": LATE, "best": best.stop}

    def _best_stop(self) -> Best:
        return best_stop(self.loop.plant, self.config, self.faults[0].actuate)

    @property
    def _stopping(self) -> bool:
        return self.loop.gateway.failsafe.action is not FailsafeAction.DRIVE

    def _begin(self, fault: CarFault) -> None:
        self.injector.begin(fault, self.loop.plant, self.loop.clock.now_ns(), self.seed)


def campaign(  # noqa: PLR0917 - what a campaign is
    track: str, points: int, spacing_s: float, faults: Sequence[Pair] = SINGLE, car: SimulatedCar | None = None,
    first_s: float = 14.0, shares: int = 1,
) -> Iterator[FaultResult]:  # fmt: skip
    """Every fault, or pair of them, from every point, each in a forked copy of the running loop; with `shares`, every
    so many-th of them from one point, the next ones from the next."""
    numbered = list(enumerate(faults))
    places = tuple(
        (first_s + point * spacing_s, tuple((1000 * point + n, pair) for n, pair in numbered[point % shares :: shares]))
        for point in range(points)
    )
    yield from from_places(track, car, places)


def from_places(
    track: str, car: SimulatedCar | None, places: Sequence[Place], learn: bool = True
) -> Iterator[FaultResult]:
    """The faults of every place, each in a forked copy of the running loop; the last result is that of the loop itself
    where it stops without a fault."""
    drives = running(track, car, [at_s for at_s, _ in places], learn)
    for (at_s, drawn), alone in zip(places, drives, strict=False):
        if alone.loop.result.failsafes:
            yield alone.stopped(at_s)
            return
        for seed, pair in drawn:
            run = replace(alone, faults=pair, seed=seed)
            result = FaultResult(**in_a_copy(run.simulate))
            yield result if result.margin_m >= 0.0 else replace(result, **in_a_copy(partial(run.why_off, result)))


def running(track: str, car: SimulatedCar | None, times_s: Sequence[float], learn: bool = True) -> Iterator[Run]:
    """The running loop after so many s of driving each, without a fault; the last one is where it stops by itself."""
    injector = SimulatedFault()
    config = Config.model_validate({"track": track, "estimator": {"learn": learn, "relinearise": learn}})
    run = Run(Loop(config, faults=injector, simulated=car), config, injector)
    for until_s in times_s:
        while run.loop.elapsed_s < until_s and not run.loop.result.failsafes:
            run.loop.step()
        yield run
        if run.loop.result.failsafes:
            return


def run_campaign(points: int, tracks: Sequence[str] = TRACKS, seed: int = 0) -> dict[str, Any]:
    """Every fault from `points` places of every track, and so many pairs; the report of `hil verify --car-faults`."""
    results: list[FaultResult] = []
    for track in tracks:
        pairs_drawn = pairs(seed, PAIRS_PER_FAULT_RUN * points)
        for result in campaign(track, points, SPACING_S, (*SINGLE, *pairs_drawn)):
            results.append(result)
            if result.margin_m < 0.0 or result.harmful:
                print(f"{track}: {result}", file=sys.stderr)
    return summary(results)


def summary(results: Sequence[FaultResult]) -> dict[str, Any]:
    """Totals of single faults and of pairs, and the stops that left the road, worst first."""
    report: dict[str, Any] = {"ok": not any(r.harmful for r in results)}
    for kind, chosen in (("single", [r for r in results if not r.pair]), ("pairs", [r for r in results if r.pair])):
        stops = [r for r in chosen if r.noticed_s is not None]
        off = sorted((r for r in stops if r.margin_m < 0.0), key=lambda r: r.margin_m)
        report[kind] = {
            "faults": len(chosen),
            "stops": len(stops),
            "off the road unnoticed": [f"{r.fault}, {r.speed:.0f} m/s" for r in chosen if r.harmful],
            "off the road by physics": sum(r.why == PHYSICS for r in off),
            "not to be held by any stop once noticed": sum(r.why in (PHYSICS, LATE) for r in off),
            "kept": 1.0 - sum(r.why != PHYSICS for r in off) / max(len(stops), 1),
            "stops off the road": [f"{r.fault}, {r.speed:.0f} m/s: {-r.margin_m:.1f} m, {r.why}" for r in off],
        }
    return report
