"""What the last valid estimate said of a car that has not moved since: an estimator that starts anew begins with it.

The gateway watches the car without a break, so that it can tell. Its own start, silence on the CAN bus or another car
on it leave nothing to begin with.
"""

from __future__ import annotations

from hil_gateway.bus.latest import Latest
from hil_gateway.bus.messages import Estimate, VehicleState
from hil_gateway.car.car import Car
from hil_gateway.gateway.perceive.duration import UNSEEN_S
from hil_gateway.gateway.perceive.road_speed import rests
from hil_gateway.observer.numbers import sound_imu_within
from hil_gateway.process.clock import NS_PER_S


class Stood:
    """`step` once a period with the newest estimate; `estimate` is there while nobody knows better."""

    def __init__(self, car: Car) -> None:
        self._turning = sound_imu_within(car)[0]
        """rad/s: who carries a car turns it faster"""
        self._last: Estimate | None = None
        self._seen_ns = 0
        self.estimate: Estimate | None = None

    def step(self, now_ns: int, state: VehicleState, newest: Latest[Estimate]) -> None:
        """Keep the newest valid estimate for as long as the car stands without a break."""
        known = newest.valid(now_ns)
        if known:
            self._last = newest.message
        watched = now_ns - self._seen_ns < UNSEEN_S * NS_PER_S
        self._seen_ns = now_ns
        if self._last is not None and not (watched and self._stands(state, self._last.bias_yaw_rate)):
            self._last = None
        self.estimate = None if known else self._last

    def _stands(self, state: VehicleState, bias_yaw_rate: float) -> bool:
        seen = all(state.sources[name].valid for name in ("wheel_speeds", "imu", "position"))
        return seen and rests(state) and abs(state.yaw_rate - bias_yaw_rate) < self._turning
