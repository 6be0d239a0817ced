"""The IMU against itself: readings that step as no car moves, and axes that have lost their noise.

Mass and inertia make forces and rates change over some periods. A reading that is steady, differs by a lot in the next
period and is steady there has another reason: an offset, a sign, a scale that went wrong. Noise of an axis is its own,
and that of two does not fall by an order of magnitude while the car drives: what has lost it no longer measures. The
observer finds either when the car next turns or brakes otherwise: in a bend, too late.
"""

from __future__ import annotations

import math
from collections import deque
from itertools import pairwise

from hil_gateway.bus.messages import VehicleState
from hil_gateway.car.car import Car
from hil_gateway.gateway.perceive.received import STUCK_FRAMES
from hil_gateway.observer.numbers import sound_imu_within
from hil_gateway.observer.observer import SLOWEST
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.settings.gateway import PERIOD_S

STEADY = 4
"""periods before and after a step: a spike of a kerb has passed by then"""
LEVEL_SHARE = 0.4
"""of a step that a reading on either side of it may differ from the one before: on a ramp all differ alike, and a spike
goes back"""
QUIET = 0.14
"""of its usual noise that one of two axes has at least: 0.145 was the least of a gyro alone on a measured drive of an
AV-21 (25 Hz, filtered, mostly motion), 0.25 of an axis on simulated ones; from less than a step of the report nothing
can be told"""
USUAL = 500
"""periods (5 s) over which the usual noise is learnt"""


class ImuMonitor:
    """Keeps the newest readings; what it has found holds until the car stands."""

    def __init__(self, car: Car) -> None:
        reports, name, v = car.codec.signals.reports, next(iter(car.imus)), car.vehicle
        rate, force = sound_imu_within(car)
        self._least = rate, force, force
        """steps beside noise, rad/s and m/s2"""
        against = v.static_load_front * v.lf + v.static_load_rear * v.lr
        self._kick = PERIOD_S * car.most_grip * against / v.yaw_inertia
        """rad/s by which both axles against each other change the yaw rate in a period"""
        self._readings: deque[tuple[float, float, float]] = deque(maxlen=2 * STEADY)
        """yaw rate, rad/s; lateral and longitudinal specific force, m/s2"""
        self._noise = tuple(_Noise(abs(reports[f"imu.{name}.{axis}"].scale)) for axis in ("yaw_rate", "ay", "ax"))
        self._stamp_ns = 0
        self.found = False

    def step(self, state: VehicleState, speed: float) -> None:
        """One period; `speed` in m/s."""
        self.found = self.found and speed > 0.0
        imu, since_ns, self._stamp_ns = state.sources["imu"], state.stamp_ns - self._stamp_ns, state.stamp_ns
        age_s = math.inf if imu.age_s is None else imu.age_s
        if speed < SLOWEST or not imu.valid or max(age_s, since_ns / NS_PER_S) >= 2 * PERIOD_S:
            # two were missed: all that changed comes at once
            self._readings.clear()
            for noise in self._noise:
                noise.forget()
            return
        if age_s >= PERIOD_S:  # it is the one before
            return
        self._readings.append((state.yaw_rate, state.ay, state.ax))
        quiet = self._quiet()
        self.found = self.found or quiet or self._stepped()

    def _stepped(self) -> bool:
        """Whether the yaw rate has stepped by more than tyres make it, or with the lateral force; or both forces have,
        one to the other sign: on less grip both fall, and a gear shift in a bend steps the other two."""
        if len(self._readings) < 2 * STEADY:
            return False
        turn, ay, ax = map(_step, zip(*self._readings, strict=True), self._least)
        _, ay_before, ax_before = self._readings[STEADY - 1]
        mirrored = min(ay_before * (ay_before + ay), ax_before * (ax_before + ax)) < 0.0
        return abs(turn) > self._kick or bool(turn and ay) or bool(ay and ax and mirrored)

    def _quiet(self) -> bool:
        """Whether the noise of two axes has fallen; learns what is usual."""
        if len(self._readings) < 3:
            return False
        newest = zip(*list(self._readings)[-3:], strict=True)
        return sum([noise.fell(*three) for noise, three in zip(self._noise, newest, strict=True)]) > 1


class _Noise:
    """Second differences of one axis, lately and usually."""

    def __init__(self, step: float) -> None:
        """`step` of its report."""
        self._step = step
        self._lately: deque[float] = deque(maxlen=STUCK_FRAMES)
        self._usual, self._learnt = 0.0, 0

    def forget(self) -> None:
        """Readings are missing."""
        self._lately.clear()

    def fell(self, before: float, last: float, now: float) -> bool:
        """Whether there is hardly any left of what was usual; three readings in a row."""
        self._lately.append(abs(now - 2.0 * last + before))
        if len(self._lately) < STUCK_FRAMES:
            return False
        self._learnt = min(self._learnt + 1, USUAL)
        self._usual += (self._lately[0] - self._usual) / self._learnt
        least = QUIET * self._usual
        return self._learnt == USUAL and least > self._step and sum(self._lately) / STUCK_FRAMES < least


def _step(readings: tuple[float, ...], least: float) -> float:
    """By how much more than `least` the later half of the readings differs from the earlier one at once; 0 where it
    does not step."""
    if abs(readings[STEADY] - readings[STEADY - 1]) <= least:
        return 0.0
    changes = [now - before for before, now in pairwise(readings)]
    step = changes.pop(STEADY - 1)
    return step if max(map(abs, changes)) < LEVEL_SHARE * abs(step) else 0.0
