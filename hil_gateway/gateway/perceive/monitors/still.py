"""An IMU that hangs: it does not move while two others both say that the car moves otherwise than before.

It may say the right thing still: a value that hangs is wrong by little at first. So changes within some tenths of a
second are compared, and short windows beside a long one: in a long one the IMU may have moved before it hung.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

from hil_gateway.bus.messages import VehicleState
from hil_gateway.config import Config
from hil_gateway.gateway.perceive.monitors.held import Held
from hil_gateway.gateway.perceive.monitors.sensors import JUDGED_FROM
from hil_gateway.gateway.perceive.motion import wheel_speeds
from hil_gateway.gateway.settings import PERIOD_S

WINDOWS = (80, 40, 20)
"""periods: a car follows its steering within 0.3 s, its brakes within 0.1 s"""
MEAN = 8
"""periods whose mean is compared: noise of gyro and wheel speeds; and over which wheels tell an acceleration"""
TURNED = 0.06
"""rad/s by which the yaw rate has changed, by steering and front wheels both"""
STEERED = 0.05
"""rad/s by steering alone, where brakes or engine have changed, too: inner wheels that brake say nothing of a turn"""
PUSHED = 2.0
"""m/s2 of that change by brakes or engine, as they are reported"""
UNEVEN = 0.0015
"""by which the slips of both front wheels come to differ a m/s2 of brakes or engine: a third of what slicks slip (0.004
on the front axle), as the inner wheel carries less"""
SLOWED = 3.0
"""m/s2 by which the acceleration has changed, by brakes or engine and by the wheels both"""
PEDALS_S = 0.03
"""s after which the car follows brakes and engine"""
SURELY = 8.0
"""m/s2 that brakes and engine give at most beside what tyres take away"""
HELD_SHARE = 0.3
"""of the declared grip that tyres hold without sliding, also on a wet road"""
SHARE = 0.25
"""of these changes which the IMU shows at least; 0.32 was the least on healthy drives of nine random cars"""
SETTLED_S = 0.04
"""s for which that must hold: an extreme of one signal passes"""


class _Changes(NamedTuple):
    """By how much the means of every signal have changed in a window, rad/s and m/s2."""

    steered: float
    wheels: float
    pushed: float
    slowed: float
    gyro: float
    across: float
    """lateral specific force over speed"""
    along: float


class StillMonitor:
    """Steering and front wheels, steering and pedals, or pedals and wheels against the IMU.

    Tyres that slide turn the car no more than before: only turns within what they surely hold, or within the force
    that is felt, count.
    """

    def __init__(self, config: Config) -> None:
        self._stop, self._vehicle, self._track = config.gateway.stop, config.vehicle, config.vehicle.track_front
        self._per_drive = config.powertrain.force_per_drive / config.vehicle.mass
        self._pushed = 0.0
        self._speeds: deque[float] = deque(maxlen=MEAN + 1)
        self._newest = tuple(deque[float](maxlen=MEAN) for _ in _Changes._fields)
        self._means = tuple(deque[float](maxlen=WINDOWS[0]) for _ in _Changes._fields)
        self._held = Held()

    def step(self, now_ns: int, state: VehicleState, speed: float, steered: float, ay: float) -> float:
        """Seconds it has stood still; `steered` is the yaw rate that the steering comes to, rad/s, `ay` the lateral
        specific force without gravity, m/s2."""
        if speed < JUDGED_FROM:
            for kept in (self._speeds, *self._newest, *self._means):
                kept.clear()
            self._pushed = self._per_drive * state.drive
            return self._held.update(False, now_ns)
        self._speeds.append(sorted(wheel_speeds(state))[-2])
        if len(self._speeds) <= MEAN:  # fewer would show an acceleration that begins
            return self._held.update(False, now_ns)
        for newest, means, value in zip(
            self._newest, self._means, self._signals(state, speed, steered, ay), strict=True
        ):
            newest.append(value)
            means.append(sum(newest) / len(newest))
        uneven = UNEVEN * speed / self._track
        held_s = self._held.update(any(self._hangs(window, uneven) for window in WINDOWS), now_ns)
        return WINDOWS[-1] * PERIOD_S + held_s if held_s > SETTLED_S else 0.0

    def _signals(self, state: VehicleState, speed: float, steered: float, ay: float) -> _Changes:
        """This period's, as far as tyres surely follow."""
        most = max(HELD_SHARE * self._stop.grip(self._vehicle, speed), abs(ay)) / speed
        wheels = (state.wheel_speed_fr - state.wheel_speed_fl) / (self._track * math.cos(state.steer))
        self._pushed += PERIOD_S / (PEDALS_S + PERIOD_S) * (self._per_drive * state.drive - self._pushed)
        slowed = (self._speeds[-1] - self._speeds[0]) / (MEAN * PERIOD_S)
        return _Changes(
            _within(most, steered), _within(most, wheels), _within(SURELY, self._pushed), _within(SURELY, slowed),
            state.yaw_rate, ay / speed, state.ax,
        )  # fmt: skip

    def _hangs(self, window: int, uneven: float) -> bool:
        """Whether the IMU has stood still in the newest `window` periods; `uneven` is the yaw rate that front wheels
        seem to show a m/s2 of brakes or engine, rad/s."""
        if len(self._means[0]) < window:
            return False
        by = _Changes(*(_range(means, window) for means in self._means))
        turned, slowed = min(by.steered, by.wheels - uneven * by.pushed), min(by.pushed, by.slowed)
        turns = max(by.gyro, by.across)
        if turned > TURNED and turns < SHARE * turned:
            return True
        if by.steered > STEERED and by.pushed > PUSHED and turns < SHARE * by.steered and by.along < SHARE * by.pushed:
            return True
        return slowed > SLOWED and by.along < SHARE * slowed


def _within(most: float, value: float) -> float:
    return min(max(value, -most), most)


def _range(values: deque[float], window: int) -> float:
    newest = list(values)[-window:]
    return max(newest) - min(newest)
