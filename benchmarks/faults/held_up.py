"""The loop as cars and computers run it: each node and process by its own clock, and now and then one is held up.

The whole loop of `planner.simulation.loop` has everything happen at once, every 10 ms. In a car no two nodes keep step,
and on a computer other programs take the processor away for some milliseconds.
"""

from __future__ import annotations

import math
import random
from typing import Any

from hil_gateway.bus import topics
from hil_gateway.config import Config
from hil_gateway.gateway.period import ANSWER_NS, LATEST_NS, next_period
from hil_gateway.plant.node import PERIOD_NS as PLANT_NS
from hil_gateway.process.clock import next_due
from hil_gateway.settings.gateway import PERIOD_NS
from planner.process import HALF_ESTIMATE_NS
from planner.simulation.loop import Loop

MS = 1_000_000
ALL = ("plant", "gateway", "estimator", "planner")
TOGETHER = (ALL, ALL[1:], *((name,) for name in ALL))
"""who is held up at once: everything, all but the car, or one of them"""
SHORTEST_MS, LONGEST_MS = 4, 45
"""of a pause: with a longer one no command comes for 0.1 s, which stops the car"""
BETWEEN_S = (0.5, 2.0)
"""pauses"""


class HeldUpLoop(Loop):
    """`step` is 10 ms of everything, a millisecond after the other."""

    def __init__(self, config: Config, seed: int, **given: Any) -> None:
        """`seed` of the pauses; with an odd one all nodes of the car have clocks of their own. The rest as `Loop`."""
        super().__init__(config, **given)
        if others := sorted({name for name, _, _ in self._schedule} - set(ALL)):
            raise ValueError(f"{', '.join(others)}: only {', '.join(ALL)} have their own times here")
        self._rng = random.Random(seed)
        now_ns = self.clock.now_ns()
        if seed % 2:
            self.plant.run_free(now_ns, self._rng)
        self._plant_ns = self._observe_ns = self._plan_ns = self._pause_ns = now_ns
        self._began_ns: int | None = None
        """when the gateway's period began whose commands have not left"""
        self._observed = self._estimated = False
        """whether a vehicle state, or an estimate, waits for an answer"""
        self._held_until_ns = dict.fromkeys(ALL, 0)

    def step(self) -> None:
        for _ in range(PERIOD_NS // MS):
            self.clock.advance(MS)
            self._step_millisecond(self.clock.now_ns())

    def _step_millisecond(self, now_ns: int) -> None:
        self.bus.flush(now_ns)
        self._pause(now_ns)
        turns = {"plant": self._drive, "gateway": self._gate, "estimator": self._estimate, "planner": self._plan}
        for name, turn in turns.items():
            if now_ns >= self._held_until_ns[name] and self.faults.runs(now_ns, name):
                turn(now_ns)
        for status in self._status.poll(now_ns):
            self._operate(now_ns, status)

    def _pause(self, now_ns: int) -> None:
        if now_ns < self._pause_ns:
            return
        self._pause_ns = now_ns + round(self._rng.uniform(*BETWEEN_S) * 1000) * MS
        length_ms = round(math.exp(self._rng.uniform(math.log(SHORTEST_MS), math.log(LONGEST_MS))))
        names = self._rng.choice(TOGETHER)
        self._held_until_ns |= dict.fromkeys(names, now_ns + length_ms * MS)
        if "gateway" in names:  # from then on its periods lie otherwise to the reports: what fits a phase fits no other
            self._observe_ns += self._rng.randrange(PERIOD_NS // MS) * MS

    def _drive(self, now_ns: int) -> None:
        if now_ns >= self._plant_ns:
            self.plant.step(now_ns)
            self._plant_ns = next_due(self._plant_ns, now_ns, PLANT_NS)

    def _gate(self, now_ns: int) -> None:
        """One of both phases of a period, as `gateway.node.run` has them."""
        gateway = self.gateway
        if self._began_ns is None and now_ns >= self._observe_ns:
            gateway.observe(now_ns)
            self._began_ns, self._observed = now_ns, True
        if self._began_ns is None or (gateway.awaits_command and self._waits(now_ns - self._observe_ns, now_ns)):
            return
        gateway.answer(now_ns)
        self._observe_ns = next_period(self._observe_ns, now_ns, self._began_ns - gateway.newest_report_ns)
        self._began_ns = None

    def _waits(self, since_ns: int, now_ns: int) -> bool:
        return since_ns < ANSWER_NS or (since_ns < LATEST_NS and not self.gateway.has_command(now_ns))

    def _estimate(self, now_ns: int) -> None:
        if self._observed:
            self.estimator.step(now_ns)
            self._observed, self._estimated = False, True

    def _plan(self, now_ns: int) -> None:
        """From an estimate that comes when one is due, or without."""
        late_ns = now_ns - self._plan_ns
        if late_ns >= HALF_ESTIMATE_NS or (late_ns >= -HALF_ESTIMATE_NS and self._estimated):
            self.planner.step(now_ns)
            self._plan_ns = now_ns + topics.PLAN.period_ns
        self._estimated = False
