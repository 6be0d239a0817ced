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
from typing import NamedTuple

from hil_gateway.car.car import Actuators
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.track.track import Track

SUB_STEP_S = 0.01
SUB_STEP_NS = round(SUB_STEP_S * NS_PER_S)
HISTORY = 100
"""sent commands remembered: one second at 100 Hz"""

Car = tuple[float, ...]
"""X, Y, yaw, vx, vy, omega: as floats, of which a handful is dealt with sooner than an array"""
Held = tuple[float, float, float]
"""drive and steer of one step, and its duration, s"""

FASTEST = (150.0, 60.0, 10.0)
"""vx and vy, m/s, and yaw rate, rad/s, that no car on four wheels reaches"""


class Late(NamedTuple):
    """By how much the inputs act later than they are reported, s."""

    drive: float = 0.0
    steer: float = 0.0


AT_ONCE = Late()


@dataclass(frozen=True)
class Sent:
    """One command as it left, own clock."""

    at_ns: int
    steer: float
    drive: float


class InputCourse:
    """An input of the car over time: as it was reported, then as what was sent will bring it about."""

    def __init__(self) -> None:
        self._points: deque[tuple[int, float]] = deque(maxlen=HISTORY)

    def report(self, at_ns: int, value: float) -> None:
        """What is measured takes the place of what was expected from then on."""
        while self._points and self._points[-1][0] >= at_ns:
            self._points.pop()
        self.expect(at_ns, value)

    def expect(self, at_ns: int, value: float) -> None:
        """What comes after all that is known; stamps must increase."""
        self._points.append((at_ns, value))

    def at(self, t_ns: int) -> float:
        """At a time, straight between two points, as the nearest one outside of them."""
        after = self._points[-1]
        for before in reversed(self._points):
            if before[0] <= t_ns:
                share = min((t_ns - before[0]) / max(after[0] - before[0], 1), 1.0)
                return before[1] + share * (after[1] - before[1])
            after = before
        return after[1]


class ActuatorModel:
    """History of sent commands, the first-order lag of steering and drive, and the courses that both have taken."""

    def __init__(self, actuators: Actuators) -> None:
        self.delay_ns = round(actuators.first_motion * NS_PER_S)
        self.steer_lag = 1.0 / (2 * math.pi * actuators.steering_bandwidth)
        self.drive_lag = 1.0 / (2 * math.pi * actuators.brake_bandwidth)
        self._sent: deque[Sent] = deque(maxlen=HISTORY)
        self.drive_course, self.steer_course = InputCourse(), InputCourse()
        self._done = self._done_in(SUB_STEP_S)

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
        for_drive, for_steer = self._done if duration == SUB_STEP_S else self._done_in(duration)
        return drive + (target.drive - drive) * for_drive, steer + (target.steer - steer) * for_steer

    def _done_in(self, duration: float) -> tuple[float, float]:
        """Shares of their ways that drive and steering make in `duration` s."""
        return -math.expm1(-duration / self.drive_lag), -math.expm1(-duration / self.steer_lag)

    def lead(self, now: float, then: float, dt: float, lag: float) -> float:
        """Command that takes an actuator from `now` to `then` in `dt` through its lag."""
        return now - (then - now) / math.expm1(-dt / lag)


@dataclass(frozen=True)
class PredictedMoment:
    """State of the car with the actuators' positions, at one time."""

    at_ns: int
    car: Car
    drive: float
    steer: float

    @property
    def finite(self) -> bool:
        """Whether every number is one."""
        return all(map(math.isfinite, (*self.car, self.drive, self.steer)))


def predict(
    actuators: ActuatorModel, advance: Callable[[Car, list[Held]], Car], now: PredictedMoment, end_ns: int,
    late: Late = AT_ONCE,
) -> PredictedMoment:  # fmt: skip
    """The moment `end_ns` from `now`; `advance(car, held)` moves the car with inputs held over each step.

    The inputs of `now` are the reported ones; they act `late`. Those of the moment are the ones that act.
    """
    at_ns, drive, steer, held, acting = now.at_ns, now.drive, now.steer, [], _Acting(actuators, late)
    actuators.drive_course.report(at_ns, drive)
    actuators.steer_course.report(at_ns, steer)
    before = acting.at(at_ns)
    while at_ns < end_ns:
        step_ns = min(SUB_STEP_NS, end_ns - at_ns)
        duration = step_ns / NS_PER_S
        drive, steer = actuators.follow(drive, steer, at_ns, duration)
        at_ns += step_ns
        actuators.drive_course.expect(at_ns, drive)
        actuators.steer_course.expect(at_ns, steer)
        then = acting.at(at_ns)
        held.append((0.5 * (then[0] + before[0]), 0.5 * (then[1] + before[1]), duration))
        before = then
    car = advance(now.car, held) if held else now.car
    return PredictedMoment(at_ns, car, *before)


class _Acting:
    """Drive and steer that act at a time."""

    def __init__(self, actuators: ActuatorModel, late: Late) -> None:
        self._drive, self._steer = actuators.drive_course, actuators.steer_course
        self._drive_ns, self._steer_ns = (round(seconds * NS_PER_S) for seconds in late)

    def at(self, t_ns: int) -> tuple[float, float]:
        return self._drive.at(t_ns - self._drive_ns), self._steer.at(t_ns - self._steer_ns)


def credible(car: Car, track: Track) -> bool:
    """Whether a car can be in this state on or near a track; not where a number is none."""
    x, y, yaw, *speeds = car
    # a comparison with what is no number is false
    moves = abs(speeds[0]) < FASTEST[0] and abs(speeds[1]) < FASTEST[1] and abs(speeds[2]) < FASTEST[2]
    return moves and track.near(x, y) and math.isfinite(yaw)
