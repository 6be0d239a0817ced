"""What the ways of driving of a learning campaign add to planner and estimator."""

from __future__ import annotations

from typing import Any

import numpy as np

from estimator.belief.tyre_belief import Sample
from estimator.node import Estimator
from hil_gateway.bus import topics
from hil_gateway.bus.interface import Bus
from hil_gateway.bus.messages import Command
from hil_gateway.config import Config
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.track.track import Track

EXCITATION_ACCELERATION = 1.5
"""lateral acceleration the added steering signals ask for, m/s2; 2.5 left 1 cm to the edge of the track"""
EXCITATION_MIN_SPEED = 15.0
EXCITATION_MAX = 0.02
"""rad"""
ADDED_SIGNAL = {"prbs": "prbs", "sine": "sine"}
"""way of driving -> steering signal added to its commands"""
KEEP_EVERY = 5
"""one sample in so many is kept for judging the drive"""


class ExcitedBus:
    """The planner's bus with a steering signal added to every command."""

    def __init__(self, bus: Bus, method: str, seed: int) -> None:
        self._bus, self._method = bus, method
        self._rng = np.random.default_rng([77, seed])
        self._state = bus.subscribe(topics.ESTIMATE)
        self._speed, self._sign, self._switch_ns = 0.0, 1.0, 0
        self.subscribe, self.close = bus.subscribe, bus.close

    def publish(self, topic: Any, message: Any) -> None:
        """Publish, commands with the signal of this moment."""
        if isinstance(message, Command):
            message = message.model_copy(update={"steer": message.steer + self._signal(message.stamp_ns)})
        self._bus.publish(topic, message)

    def _signal(self, now_ns: int) -> float:
        """Steering angle to add, rad: sized for one lateral acceleration at every speed."""
        for estimate in self._state.poll(now_ns):
            self._speed = estimate.vx
        if self._speed < EXCITATION_MIN_SPEED:
            return 0.0
        amplitude = min(EXCITATION_ACCELERATION * 3.0 / self._speed**2, EXCITATION_MAX)
        return amplitude * (self._prbs(now_ns) if self._method == "prbs" else self._sine(now_ns))

    def _prbs(self, now_ns: int) -> float:
        """+-1, held for 0.2 to 0.8 s."""
        if now_ns >= self._switch_ns:
            self._sign = -self._sign
            self._switch_ns = now_ns + int(self._rng.uniform(0.2, 0.8) * NS_PER_S)
        return self._sign

    def _sine(self, now_ns: int) -> float:
        """Sine sweeping from 0.3 to 1.2 Hz and back every 20 s."""
        t = now_ns / NS_PER_S
        return float(np.sin(2 * np.pi * (0.75 * t - 0.45 * 20.0 / (2 * np.pi) * np.cos(2 * np.pi * t / 20.0))))


class RecordingEstimator(Estimator):
    """Estimator that keeps some samples."""

    def __init__(self, config: Config, bus: Bus, track: Track | None = None) -> None:
        super().__init__(config, bus, track)
        self.kept: list[Sample] = []
        self._seen = 0

    def learn(self, sample: Sample, stamp_ns: int) -> None:
        """See `Estimator.learn`."""
        self._seen += 1
        if self._seen % KEEP_EVERY == 0:
            self.kept.append(sample)
        super().learn(sample, stamp_ns)
