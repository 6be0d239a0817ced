"""Where the time of a whole plan goes: a drive's messages are given to a planner again, and its parts are timed.

Messages come and go as bytes, as between processes. The planner answers each step from what it heard then, so the same
drive gives the same plans, whatever they cost.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import wraps
from typing import Any, TypeVar

import numpy as np

from hil_gateway.bus.interface import Bus, LocalBus, LocalSubscription
from hil_gateway.bus.messages import Message, Plan
from hil_gateway.bus.topics import APPLIED, BELIEF, ESTIMATE, MODEL_REVISION, Topic
from hil_gateway.config import Config
from hil_gateway.process.arrays import Array
from hil_gateway.track.track import Track
from planner.node import Planner
from planner.plan.checks import PlanCheck
from planner.plan.controller import Controller
from planner.plan.publishing import Publisher
from planner.simulation.loop import Loop
from planner.solver.sqp import Sqp, Stopwatch

M = TypeVar("M", bound=Message)

HEARD = (APPLIED, BELIEF, ESTIMATE, MODEL_REVISION)
"""topics of the planner"""
COLD = 40
"""plans at the start that do not count: cold starts"""
WHOLE, REST, READY, BETWEEN = "whole plan", "rest", "made ready", "between plans"
"""the last two are no part of the whole: what is done before the estimate is read, and after the plan is published"""
PARTS: tuple[tuple[str, type, str], ...] = (
    (READY, Planner, "_carry_on"),
    (BETWEEN, Planner, "_adopt"),
    ("predicted state", Planner, "_initial_state"),
    ("parameters", Controller, "shift"),
    ("parameters", Controller, "solve"),
    ("solver", Sqp, "solve"),
    ("information weight", Controller, "_weigh_information"),
    ("acceptance", PlanCheck, "__call__"),
    ("publishing", Publisher, "__call__"),
)
"""name of a part, and a method whose time, without that of other parts inside it, belongs to it"""


@dataclass(frozen=True)
class Step:
    """One step of the planner: its time and what had arrived since the step before."""

    now_ns: int
    messages: tuple[tuple[Topic[Any], bytes], ...]


class _Ear:
    """Stands in for the planner of a loop and keeps what the planner hears."""

    def __init__(self, planner: Planner, bus: Bus, steps: list[Step]) -> None:
        self._planner, self._steps = planner, steps
        self._heard = [(topic, bus.subscribe(topic, depth=50)) for topic in HEARD]

    def step(self, now_ns: int) -> Plan | None:
        messages = [(topic, m.model_dump_json().encode()) for topic, s in self._heard for m in s.poll(now_ns)]
        self._steps.append(Step(now_ns, tuple(messages)))
        return self._planner.step(now_ns)


def recorded_drive(config: Config, seconds: float) -> list[Step]:
    """What the planner hears in a drive of so many seconds in the loop."""
    steps: list[Step] = []

    def ear(config: Config, bus: Bus, track: Track) -> _Ear:
        return _Ear(Planner(config, bus, track), bus, steps)

    Loop(config, components={"planner": ear}).run(seconds=seconds)
    return steps


class _BytesSubscription(LocalSubscription[Any]):
    """Parses what was published as bytes, when it is asked for."""

    def __init__(self, topic: Topic[Any], depth: int) -> None:
        super().__init__(depth)
        self._topic = topic

    def poll(self, now_ns: int) -> list[Any]:
        payloads: list[Any] = super().poll(now_ns)
        return [self._topic.message.model_validate_json(payload) for payload in payloads]


class BytesBus(LocalBus):
    """Local bus that carries bytes, as the one between processes does."""

    def publish(self, topic: Topic[M], message: M) -> None:
        self.deliver(topic, message.model_dump_json().encode())

    def deliver(self, topic: Topic[Any], payload: bytes) -> None:
        """Hand a message over that is bytes already."""
        for subscription in self._subscriptions.get(topic.key, ()):
            subscription.push(payload)

    def subscribe(self, topic: Topic[M], depth: int = 1) -> LocalSubscription[M]:
        subscription = _BytesSubscription(topic, depth)
        self._subscriptions.setdefault(topic.key, []).append(subscription)
        return subscription


@dataclass
class PartTimes:
    """Durations of nested parts, ns, each without the parts inside it; `plans` has one entry a plan."""

    stopwatch: Stopwatch
    plans: list[dict[str, int]] = field(default_factory=list)
    _inside: list[int] = field(default_factory=lambda: [0])
    _outside: str = ""
    """name of the part that is running and that is, with all that it calls, no part of the whole"""

    def timed(self, name: str, method: Callable[..., Any]) -> Callable[..., Any]:
        """`method`, its time counted as that of part `name`."""

        @wraps(method)
        def measured(*args: Any, **kwargs: Any) -> Any:
            self._inside.append(0)
            outside, self._outside = self._outside, self._outside or (name if name in (READY, BETWEEN) else "")
            began = self.stopwatch()
            try:
                return method(*args, **kwargs)
            finally:
                took = self.stopwatch() - began
                own = took - self._inside.pop()
                self._inside[-1] += took
                part = self._outside or name
                self.plans[-1][part] = self.plans[-1].get(part, 0) + own
                self._outside = outside

        return measured


@contextmanager
def _all_timed(times: PartTimes) -> Iterator[None]:
    """Every method of `PARTS` timed inside the block, and as it was afterwards."""
    with ExitStack() as undo:
        for name, owner, method in PARTS:
            plain = getattr(owner, method)
            undo.callback(setattr, owner, method, plain)
            setattr(owner, method, times.timed(name, plain))
        yield


def replay(
    config: Config, track: Track, steps: Sequence[Step], stopwatch: Stopwatch, pause_s: float = 0.0
) -> tuple[PartTimes, list[Plan]]:
    """Durations of the parts of every plan, and the plans, of a planner that hears a recorded drive.

    `pause_s` before each plan leaves caches to others, as in a drive.
    """
    bus, times, plans = BytesBus(), PartTimes(stopwatch), []
    planner = Planner(config, bus, track)
    with _all_timed(times):
        step = times.timed(REST, planner.step)
        for recorded in steps:
            for topic, payload in recorded.messages:
                bus.deliver(topic, payload)
            times.plans.append({})
            time.sleep(pause_s)
            if plan := step(recorded.now_ns):
                plans.append(plan)
            else:
                times.plans.pop()
    return times, plans


def shares(times: PartTimes) -> list[dict[str, float | str]]:
    """Rows of a table: p50 and p99 of each part, ms, and its share of all the time; the whole plan first."""
    counted = times.plans[COLD:]
    names = dict.fromkeys([*(name for name, _, _ in PARTS), REST])
    columns = {WHOLE: np.array([sum(plan.values()) - plan[READY] - plan[BETWEEN] for plan in counted]) / 1e6}
    columns |= {name: np.array([plan.get(name, 0) for plan in counted]) / 1e6 for name in names}
    return [_row(name, values, float(columns[WHOLE].sum())) for name, values in columns.items()]


def _row(name: str, values: Array, whole: float) -> dict[str, float | str]:
    p50, p99 = np.percentile(values, [50, 99])
    share = float(values.sum()) / whole
    return {"part": name, "p50_ms": round(p50, 4), "p99_ms": round(p99, 4), "share": round(share, 3)}
