"""Runs seeds: one loop is driven to several points of the track, and every seed starts from a copy of it there.

The copies are forked processes: a fork is an exact copy of the loop, costs some milliseconds, and leaves the
original untouched, so seed N does the same alone as in a campaign.
"""

from __future__ import annotations

import gc
import json
import os
import resource
import sys
import time
import traceback
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from benchmarks.faults.faults import Kind, SeededFaults, draw
from benchmarks.faults.invariants import STOP_WITHIN_S, Watch
from benchmarks.promises.wire_judge import Judge
from hil_gateway.bus.messages import FailsafeAction, Message
from hil_gateway.bus.topics import APPLIED, VEHICLE_STATE, Topic
from hil_gateway.config import Config
from hil_gateway.process.clock import NS_PER_S
from planner.simulation.loop import Faults, Loop

START_POINTS_S = (6.0, 11.0, 16.0, 23.0, 29.0)
"""s of driving at which seeds start, by seed modulo their number: standing start, straight, bends"""
SHORT_S = 1.8
"""most seeds end so soon: every reaction is due within 0.6 s of its fault"""
FULL_EVERY = 10
"""each so many-th seed goes on until the car stands"""
DEFAULTS: dict[str, Any] = {"planner": {"horizon": 20}}
"""A short horizon: speed."""


class Switch(Faults):
    """No faults until a seed's are put in."""

    def __init__(self) -> None:
        self.seeded: SeededFaults | None = None
        self.watch: Watch | None = None

    def frames(self, now_ns: int, receiver: str, frames: list[Any]) -> list[Any]:
        return frames if self.seeded is None else self.seeded.frames(now_ns, receiver, frames)

    def messages(self, now_ns: int, topic: Topic[Any], message: Message) -> Any:
        if self.seeded is None:
            return ((now_ns, message),)
        if self.watch is not None and topic in (APPLIED, VEHICLE_STATE):
            self.watch.published(now_ns, message)
        return self.seeded.messages(now_ns, topic, message)

    def runs(self, now_ns: int, component: str) -> bool:
        return self.seeded is None or self.seeded.runs(now_ns, component)


@dataclass(frozen=True)
class SeedResult:
    """What one seed came to."""

    seed: int
    seconds: float
    """virtual time simulated"""
    faults: tuple[str, ...]
    kinds: tuple[str, ...]
    action: str
    cause: str
    broken: str
    """the promise that did not hold, empty when all did"""
    worst_margin_m: float


class Campaign:
    """One loop, driven forward once."""

    def __init__(self, config: Config | None = None) -> None:
        self.switch = Switch()
        self.loop = Loop(config or Config.model_validate(DEFAULTS), faults=self.switch)
        Judge()  # its decoder takes 0.3 s to load: once here instead of in every copy

    def run(self, seeds: Sequence[int], workers: int = 2) -> Iterator[SeedResult]:
        """Results in the order in which they come in."""
        copies = _Copies(self)
        for group, point_s in enumerate(START_POINTS_S):
            mine = [seed for seed in seeds if seed % len(START_POINTS_S) == group]
            if mine:
                self._drive_to(point_s)  # while the last copies of the point before still run
            for seed in mine:
                yield from copies.reap(workers - 1)
                copies.start(seed)
        yield from copies.reap(0)

    def run_here(self, seed: int) -> SeedResult:
        """One seed in this process (which is of no use for another one afterwards)."""
        self._drive_to(START_POINTS_S[seed % len(START_POINTS_S)])
        return self.simulate(seed)

    def _drive_to(self, seconds: float) -> None:
        while self.loop.elapsed_s < seconds or not self.loop.result.armed:
            self.loop.step()

    def simulate(self, seed: int) -> SeedResult:
        """Faults of `seed` from the present state of the loop on."""
        loop = self.loop
        start_ns = loop.clock.now_ns()
        episodes = draw(seed, start_ns)
        faults = SeededFaults(seed, episodes)
        watch = Watch(loop, loop.wire.link())
        self.switch.seeded, self.switch.watch = faults, watch
        loop.plant.referee.worst_margin_m = float("inf")
        limit_s = STOP_WITHIN_S + 2.0 if seed % FULL_EVERY == 0 else SHORT_S
        try:
            self._tick_until(start_ns + int(limit_s * NS_PER_S), faults, watch)
        except Exception as error:  # whatever a core raises is a failure of this seed
            place = traceback.extract_tb(error.__traceback__)[-1]
            watch.broken = f"exception: {error!r} at {place.filename}:{place.lineno}"
        watch.finish(frames_reach_the_car=not any(e.kind is Kind.CLOCK_JUMP for e in episodes))
        return SeedResult(
            seed=seed,
            seconds=(loop.clock.now_ns() - start_ns) / NS_PER_S,
            faults=tuple(map(str, episodes)),
            kinds=tuple(episode.kind.value for episode in episodes),
            action=watch.severity.value,
            cause=loop.gateway.failsafe.cause,
            broken=watch.broken,
            worst_margin_m=loop.plant.referee.worst_margin_m,
        )

    def _tick_until(self, end_ns: int, faults: SeededFaults, watch: Watch) -> None:
        loop = self.loop
        while loop.clock.now_ns() < end_ns and not watch.broken:
            loop.wire.up = not faults.bus_off(loop.clock.now_ns())
            loop.clock.advance(faults.jump_ns(loop.clock.now_ns()))
            loop.step()
            watch.check(loop.clock.now_ns())
            if watch.severity is not FailsafeAction.DRIVE and loop.plant.car.standing:
                return


class _Copies:
    """Forked copies of a campaign's loop, each simulating one seed."""

    def __init__(self, campaign: Campaign) -> None:
        self._campaign = campaign
        self._running: dict[int, tuple[int, int]] = {}
        """process -> its seed and the pipe of its result"""

    def reap(self, most: int) -> Iterator[SeedResult]:
        """Results of copies that end, until at most so many still run."""
        while len(self._running) > most:
            pid, _ = os.wait()
            seed, reader = self._running.pop(pid)
            with os.fdopen(reader) as pipe:
                text = pipe.read()
            yield SeedResult(**json.loads(text)) if text else _lost(seed)

    def start(self, seed: int) -> None:
        """One more copy; its result comes as one JSON line through the pipe."""
        gc.freeze()  # a collection in the copy would touch, and so copy, every page of the loop
        reader, writer = os.pipe()
        if pid := os.fork():
            os.close(writer)
            self._running[pid] = seed, reader
            return
        status = 1
        try:
            os.write(writer, json.dumps(asdict(self._campaign.simulate(seed))).encode())
            status = 0
        finally:
            os._exit(status)


def _lost(seed: int) -> SeedResult:
    return SeedResult(seed, 0.0, (), (), "", "", "the simulating process died", float("nan"))


def summarise(results: Sequence[SeedResult], wall_s: float, cpu_s: float) -> dict[str, Any]:
    """Totals of a campaign for people and for JSON."""
    virtual_s = sum(result.seconds for result in results)
    broken = [result for result in results if result.broken]
    kinds: dict[str, int] = {}
    actions: dict[str, int] = {}
    for result in results:
        actions[result.action] = actions.get(result.action, 0) + 1
        for kind in result.kinds:
            kinds[kind] = kinds.get(kind, 0) + 1
    return {
        "seeds": len(results),
        "broken": [{"seed": r.seed, "broken": r.broken, "faults": r.faults, "repeat": repeat(r.seed)} for r in broken],
        "virtual_s": round(virtual_s, 1),
        "wall_s": round(wall_s, 1),
        "times_real_time": round(virtual_s / wall_s, 1),
        "times_real_time_per_core": round(virtual_s / cpu_s, 1),
        "kinds": kinds,
        "actions": actions,
    }


def repeat(seed: int) -> str:
    """Command that runs one seed again."""
    return f"hil verify --seed {seed}"


def run_campaign(seeds: Sequence[int], workers: int = 2) -> dict[str, Any]:
    """Run seeds and sum up; wall time from the finished loop on, CPU time of the seeds alone."""
    campaign = Campaign()
    started, cpu_started = time.perf_counter(), _children_cpu_s()
    results: list[SeedResult] = []
    for result in campaign.run(seeds, workers):
        results.append(result)
        if result.broken:
            print(f"seed {result.seed}: {result.broken}; {repeat(result.seed)}", file=sys.stderr)
    return summarise(results, time.perf_counter() - started, _children_cpu_s() - cpu_started)


def _children_cpu_s() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime
