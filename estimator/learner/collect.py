"""Laps as they are driven, as drive-log columns in memory: what offline diagnosis reads from a recording.

Specific forces are without the biases that the state filter estimates, as the belief takes them, and the load that the
road adds is a column of its own: what is found belongs to the same model that is driven with.
"""

from __future__ import annotations

from collections import OrderedDict, deque
from dataclasses import dataclass, field

import numpy as np

from estimator.learner.learnt_model import SPREAD
from estimator.model.extra_load import extra_load
from hil_gateway.bus.interface import Bus
from hil_gateway.bus.messages import ESTIMATED, Estimate, Plan, VehicleState
from hil_gateway.bus.topics import ESTIMATE, PLAN, VEHICLE_STATE
from hil_gateway.process.arrays import Array
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.session.drive_table import FROM_ESTIMATE, FROM_STATE

MOST_LAPS = 5
"""complete laps kept, the newest: four to learn from take a quarter of an hour of one slow processor at most"""
MOST_ROWS = 30_000
"""of one lap, five minutes at 100 Hz: what is slower than that is no lap"""
QUEUE_S = 5.0
"""how long the learner may be held up before rows are lost"""
WAITING = 100
"""vehicle states kept until their estimate comes, one second"""
COLUMNS = ("t", *FROM_ESTIMATE, *FROM_STATE, "extra_load", *SPREAD)
VX, YAW_RATE = ESTIMATED.index("vx"), ESTIMATED.index("yaw_rate")


@dataclass
class CollectedLap:
    """One lap, `number` counted by the collector: a planner that begins again counts from 0."""

    number: int
    began_ns: int
    lasted_s: float = 0.0
    """to one plan, once it is over"""
    rows: list[tuple[float, ...]] = field(default_factory=list)


class Collector:
    """The newest laps; `step` takes in what has arrived."""

    def __init__(self, bus: Bus) -> None:
        self._states = bus.subscribe(VEHICLE_STATE, depth=round(QUEUE_S * VEHICLE_STATE.rate_hz))
        self._estimates = bus.subscribe(ESTIMATE, depth=round(QUEUE_S * ESTIMATE.rate_hz))
        self._plans = bus.subscribe(PLAN, depth=round(QUEUE_S * PLAN.rate_hz))
        self._waiting: OrderedDict[int, VehicleState] = OrderedDict()
        self._over: deque[CollectedLap] = deque(maxlen=MOST_LAPS)
        self._under_way: CollectedLap | None = None
        self.done = 0
        """laps over since the learner began"""
        self.stamp_ns = self._added_ns = 0
        """of the newest vehicle state, and of the newest row"""
        self.plan: Plan | None = None

    @property
    def complete(self) -> list[int]:
        """Numbers of the laps that are over, oldest first."""
        return [lap.number for lap in self._over]

    def lap_s(self, number: int) -> float:
        """Time of a complete lap, to one plan."""
        return next(lap.lasted_s for lap in self._over if lap.number == number)

    def columns(self) -> dict[str, Array]:
        """name -> (n,) columns of the complete laps, `lap` among them."""
        rows = np.array([row for lap in self._over for row in lap.rows])
        columns = dict(zip(COLUMNS, rows.T, strict=True))
        columns["lap"] = np.repeat(np.array(self.complete, float), [len(lap.rows) for lap in self._over])
        columns["t"] = columns["t"] - columns["t"][0]
        return columns

    def step(self, now_ns: int) -> None:
        """Take in what has arrived."""
        for state in self._states.poll(now_ns):
            self._waiting[state.stamp_ns], self.stamp_ns = state, state.stamp_ns
            if len(self._waiting) > WAITING + QUEUE_S * VEHICLE_STATE.rate_hz:
                self._waiting.popitem(last=False)
        for plan in self._plans.poll(now_ns):
            self._note_lap(plan)
        for estimate in self._estimates.poll(now_ns):
            if estimate.state_stamp_ns in self._waiting:
                state = self._waiting.pop(estimate.state_stamp_ns)
                if estimate.valid:
                    self._add(state, estimate)

    def _note_lap(self, plan: Plan) -> None:
        """Laps follow one another; where the planner's count jumps, what is left of that lap is no whole one."""
        before, self.plan = self.plan, plan
        if before is not None and plan.lap == before.lap:
            return
        if before is not None and plan.lap != before.lap + 1:
            self._under_way = None
            return
        lap = self._under_way
        if lap is not None and lap.rows:
            lap.lasted_s = (plan.state_stamp_ns - lap.began_ns) / NS_PER_S
            self._over.append(lap)
        self.done += before is not None
        self._under_way = CollectedLap(self.done, plan.state_stamp_ns)

    def _add(self, state: VehicleState, estimate: Estimate) -> None:
        """One row, of the lap that had begun at its stamp; a state without new frames has the stamp of the last."""
        if state.stamp_ns <= self._added_ns or self._under_way is None:
            return
        self._added_ns = state.stamp_ns
        late = state.stamp_ns < self._under_way.began_ns and self._over
        lap = self._over[-1] if late else self._under_way
        if len(lap.rows) < MOST_ROWS:
            lap.rows.append(_row(state, estimate))


def _row(state: VehicleState, estimate: Estimate) -> tuple[float, ...]:
    """Values in the order of `COLUMNS`."""
    values = {name: get(state) for name, get in FROM_STATE.items()}
    values["ax"], values["ay"] = state.ax - estimate.bias_ax, state.ay - estimate.bias_ay
    motion = (get(estimate) for get in FROM_ESTIMATE.values())
    spread = estimate.std[VX : YAW_RATE + 1]
    return (state.stamp_ns / NS_PER_S, *motion, *values.values(), extra_load(state.az), *spread)
