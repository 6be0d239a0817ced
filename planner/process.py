"""The planner as a process: on the bus, on the clock of the computer, 20 times a second."""

from __future__ import annotations

import gc
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

from hil_gateway.bus.interface import Bus
from hil_gateway.bus.topics import ESTIMATE, RUN
from hil_gateway.bus.track_day.run import RunPhase, RunStatus
from hil_gateway.bus.zenoh_bus import open_bus
from hil_gateway.config import Config
from hil_gateway.process.clock import NS_PER_S, Clock, SystemClock, wait_for
from hil_gateway.process.journal import Journal
from hil_gateway.process.lifecycle import SilenceNotice, StopRequest
from hil_gateway.process.scheduling import punctual, use_large_pages

HALF_ESTIMATE_NS = ESTIMATE.period_ns // 2
"""A plan is prepared so long before the estimate that it begins from is due, and waits as long beyond that."""


def run(config: Config) -> None:
    """Plan every `planner.dt`, from an estimate as it comes, until asked to stop."""
    stop, clock = StopRequest(), SystemClock()
    bus = open_bus(config.zenoh, "planner")
    with announced(bus, clock):
        from planner.node import Planner  # takes seconds, too

        planner = Planner(config, bus, stopwatch=time.perf_counter_ns, background=True)
    punctual("planner")
    gc.freeze()  # what start-up allocated is never collected: shorter pauses
    use_large_pages()
    period_ns = round(config.planner.dt * NS_PER_S)
    due_ns = clock.now_ns()
    """when an estimate is due that a plan begins from"""
    notice = SilenceNotice("estimate", config.zenoh.connect, due_ns)
    try:
        with Journal():
            while not stop():
                planner.prepare(clock.now_ns())
                if wait_for(clock, lambda: planner.has_news(clock.now_ns()), due_ns + HALF_ESTIMATE_NS):
                    due_ns = clock.now_ns()
                plan = planner.plan(clock.now_ns())
                notice.step(clock.now_ns(), received=plan is not None)
                due_ns = max(due_ns + period_ns, clock.now_ns())
                clock.sleep_until(due_ns - HALF_ESTIMATE_NS)
    finally:
        planner.store_limits()
        bus.close()


@contextmanager
def announced(bus: Bus, clock: Clock) -> Iterator[None]:
    """Says that a planner is there while it is made: the first time, compiling takes half a minute."""
    made = threading.Event()

    def announce() -> None:
        seq = 0
        while not made.wait(1.0 / RUN.rate_hz):
            bus.publish(RUN, RunStatus(stamp_ns=clock.now_ns(), seq=seq, phase=RunPhase.STARTING, number=0))
            seq += 1

    thread = threading.Thread(target=announce)
    thread.start()
    try:
        yield
    finally:
        made.set()
        thread.join()
