"""The estimator's core with a car that goes round a track, and everything that it publishes."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from estimator.node import Estimator
from hil_gateway.bus import topics
from hil_gateway.bus.interface import LocalBus
from hil_gateway.bus.messages import Estimate, VehicleState
from hil_gateway.car.car import load_car
from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.config import Config, EstimatorConfig
from hil_gateway.track.track import Track

DT_NS = 10_000_000
START_NS = 1_000_000_000
VEHICLE = load_car().vehicle


@dataclass
class Car:
    """Moves along the centre line at a set speed; its sensors are exact but for seeded noise."""

    track: Track
    speed: float = 30.0
    s: float = 100.0
    seed: int = 1
    k: int = 0
    grip: float = 1.0
    changes: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng(self.seed)

    def state(self) -> VehicleState:
        p, v = self.track.at(self.s), self.speed
        rate = float(p.curvature) * v
        slip = np.arcsin(np.clip(v * rate / (1.3 * GRAVITY * self.grip), -0.99, 0.99)) / 13.0
        noise = self._rng.normal
        values: dict[str, Any] = {
            "ax": GRAVITY * np.sin(p.grade) + noise(0, 0.05),
            "ay": v * rate + GRAVITY * np.sin(p.bank) + noise(0, 0.05),
            "az": GRAVITY,
            "yaw_rate": rate + noise(0, 0.002),
            "roll_rate": 0.0,
            "steer": float(VEHICLE.wheelbase * rate / max(v, 1.0)) + float(slip - slip),
            "position_x": float(p.x) + noise(0, 0.02),
            "position_y": float(p.y) + noise(0, 0.02),
            "position_seq": 1 + self.k,
            "drive": 0.02,
        }
        values |= {f"wheel_speed_{w}": v for w in ("fl", "fr", "rl", "rr")}
        zero = ("steer_rate", "accelerator", "throttle", "brake_front", "brake_rear", "engine_speed")
        values |= dict.fromkeys(zero, 0.0)
        values |= dict.fromkeys(("gear", "sys_state", "ct_state", "track_flag", "vehicle_flag"), 1)
        values |= self.changes
        stamp = START_NS + self.k * DT_NS
        self.k += 1
        self.s += v * DT_NS * 1e-9
        return VehicleState(stamp_ns=stamp, seq=self.k, valid=True, sources={}, **values)


class Bench:
    """Estimator with its inputs and everything it publishes."""

    def __init__(self, track: Track, **config: Any) -> None:
        self.bus = LocalBus()
        keys = (topics.ESTIMATE, topics.BELIEF, topics.MODEL_REVISION, topics.ALERT)
        self.out = {t.key: self.bus.subscribe(t, depth=100_000) for t in keys}
        self.estimator = Estimator(Config(estimator=EstimatorConfig(**config)), self.bus, track)

    def feed(self, *states: VehicleState) -> list[Estimate]:
        for state in states:
            self.bus.publish(topics.VEHICLE_STATE, state)
            self.estimator.step(state.stamp_ns)
        return self.out[topics.ESTIMATE.key].poll(0)
