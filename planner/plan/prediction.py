"""Where the car will be when a command given now begins to act: dead time and lag of the actuators made up for.

What was sent is known; the actuators follow it after a dead time with a first-order lag. The plan starts at the
moment its first action can act, and the command is chosen so that the lagging actuator is where the plan wants it
one interval later.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hil_gateway.config import PlannerConfig
from hil_gateway.process.arrays import Array
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.track.track import Track

SUB_STEP_S = 0.01
HISTORY = 100
"""sent commands remembered: one second at 100 Hz"""

FASTEST = np.array([150.0, 60.0, 10.0])
"""vx and vy, m/s, and yaw rate, rad/s, that no car on four wheels reaches"""


@dataclass(frozen=True)
class Sent:
    """One command as it left, own clock."""

    at_ns: int
    steer: float
    drive: float


class Actuators:
    """History of sent commands and the first-order lag of steering and drive."""

    def __init__(self, config: PlannerConfig) -> None:
        self.delay_ns = round(config.actuator_delay_s * NS_PER_S)
        self.steer_lag = 1.0 / (2 * math.pi * config.steer_bandwidth_hz)
        self.drive_lag = 1.0 / (2 * math.pi * config.drive_bandwidth_hz)
        self._sent: deque[Sent] = deque(maxlen=HISTORY)

    def record(self, sent: Sent) -> None:
        """Remember a command; stamps must not decrease."""
        self._sent.append(sent)

    def input_at(self, t_ns: int) -> Sent | None:
        """The command that acts at `t_ns`: the last one sent a dead time before; None before the first."""
        latest_ns = t_ns - self.delay_ns
        for sent in reversed(self._sent):
            if sent.at_ns <= latest_ns:
                return sent
        return None

    def follow(self, drive: float, steer: float, t_ns: int, duration: float) -> tuple[float, float]:
        """Actuator positions `duration` s after `t_ns`, moving towards what acts at `t_ns`."""
        target = self.input_at(t_ns)
        if target is None:
            return drive, steer
        drive += (target.drive - drive) * -math.expm1(-duration / self.drive_lag)
        steer += (target.steer - steer) * -math.expm1(-duration / self.steer_lag)
        return drive, steer

    def lead(self, now: float, then: float, dt: float, lag: float) -> float:
        """Command that takes an actuator from `now` to `then` in `dt` through its lag."""
        return now - (then - now) / math.expm1(-dt / lag)


@dataclass(frozen=True)
class Moment:
    """Car state (6,) = X, Y, yaw, vx, vy, omega with the actuators' positions, at one time."""

    at_ns: int
    car: Array
    drive: float
    steer: float


def predict(actuators: Actuators, advance: Callable[[Array, Array], Array], now: Moment, end_ns: int) -> Moment:
    """The moment `end_ns` from `now`; `advance(car, held)` moves the car, (6,), with inputs held over each step.

    `held` (3, K) are drive, steer and duration, s.
    """
    at_ns, drive, steer, held = now.at_ns, now.drive, now.steer, []
    while at_ns < end_ns:
        step_ns = min(round(SUB_STEP_S * NS_PER_S), end_ns - at_ns)
        duration = step_ns / NS_PER_S
        before = drive, steer
        drive, steer = actuators.follow(drive, steer, at_ns, duration)
        held.append((0.5 * (drive + before[0]), 0.5 * (steer + before[1]), duration))
        at_ns += step_ns
    car = advance(now.car, np.array(held).T) if held else now.car
    return Moment(at_ns, car, drive, steer)


def credible(car: Array, track: Track) -> bool:
    """Whether a car (6,) can be in this state on or near a track; not where a number is none."""
    near = track.near(float(car[0]), float(car[1]))
    # a comparison with what is no number is false
    return bool(near and math.isfinite(car[2]) and (np.abs(car[3:]) < FASTEST).all())
