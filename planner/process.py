"""The planner as a process: on the bus, on the clock of the computer, 20 times a second."""

from __future__ import annotations

import gc
import time

from hil_gateway.bus.zenoh_bus import open_bus
from hil_gateway.config import Config
from hil_gateway.process.clock import NS_PER_S, SystemClock
from hil_gateway.process.lifecycle import SilenceNotice, StopRequest
from hil_gateway.process.scheduling import punctual, use_large_pages
from planner.node import Planner


def run(config: Config) -> None:
    """Plan at 20 Hz until asked to stop."""
    stop, clock = StopRequest(), SystemClock()
    bus = open_bus(config.zenoh, "planner")
    planner = Planner(config, bus, stopwatch=time.perf_counter_ns, background=True)
    punctual("planner")
    gc.freeze()  # what start-up allocated is never collected: shorter pauses
    use_large_pages()
    period_ns = round(config.planner.dt * NS_PER_S)
    due_ns = clock.now_ns()
    notice = SilenceNotice("estimate", config.zenoh.connect, due_ns)
    try:
        while not stop():
            plan = planner.step(clock.now_ns())
            notice.step(clock.now_ns(), received=plan is not None)
            due_ns = max(due_ns + period_ns, clock.now_ns())
            clock.sleep_until(due_ns)
    finally:
        planner.store_limits()
        bus.close()
