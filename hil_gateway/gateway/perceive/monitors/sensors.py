"""Axles against each other, and the change of speed by the wheels against that by the IMU."""

from __future__ import annotations

import math
from collections import deque

from hil_gateway.bus.messages import VehicleState
from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.config import Config
from hil_gateway.gateway.perceive.duration import ConditionTime
from hil_gateway.settings.gateway import PERIOD_S

JUDGED_FROM = 8.0
"""m/s: slower, differences of wheel speeds are within what parking manoeuvres and clutch make"""
DRIVEN = 2.0
"""m/s2 by the engine from which the driven wheels' slip shows beside the noise of wheel speeds"""
STIFFEST = 100.0
"""force of the driven wheels over their load a unit of slip: four times that of slicks (25), twice that of stiffer
racing tyres"""
ROLLING = 0.5
"""m/s2 by the engine below which wheels roll"""
RADII_MOST = 0.03
"""that rolling radii may differ from the declared one: pressure, wear, growth with speed"""
ROLLED_S = 0.5
"""s of rolling in which the radii's ratio is learnt"""
SLIPPED_S = 0.1
"""time constant, s: noise of the wheel speeds (0.3 % of a sample)"""


class AxleMonitor:
    """Rear wheels, which the engine drives, turn faster than front wheels under power: else the axles are swapped.

    Front wheels roll on a path of their own in a bend: v cos(delta) + L r sin(delta) at the speed v of the rear axle.
    """

    def __init__(self, config: Config) -> None:
        self._vehicle = car = config.vehicle
        self._per_drive = config.powertrain.force_per_drive / car.mass
        self._drive_slip = car.wheelbase / (STIFFEST * GRAVITY * car.lf)
        """of the driven wheels a m/s2, at least"""
        self._radii = self._slip = 0.0
        """rear over front wheels' speed less 1: rolling, and lately"""
        self._held = ConditionTime()

    def step(self, now_ns: int, state: VehicleState, speed: float) -> float:
        """Seconds the driven wheels have turned slower."""
        if speed < JUDGED_FROM:
            self._slip = self._radii
            return self._held.update(False, now_ns)
        driven = self._per_drive * state.drive
        faster = self._rear_over_front(state) - 1.0
        if abs(driven) < ROLLING:
            self._radii += PERIOD_S / ROLLED_S * (min(max(faster, -RADII_MOST), RADII_MOST) - self._radii)
        self._slip += PERIOD_S / (SLIPPED_S + PERIOD_S) * (faster - self._slip)
        pushed = min(driven, state.ax + self._vehicle.drag(speed))
        swapped = pushed > DRIVEN and self._slip - self._radii < -self._drive_slip * pushed
        return self._held.update(swapped, now_ns)

    def _rear_over_front(self, state: VehicleState) -> float:
        rear = 0.5 * (state.wheel_speed_rl + state.wheel_speed_rr)
        front = 0.5 * (state.wheel_speed_fl + state.wheel_speed_fr)
        path = rear * math.cos(state.steer) + self._vehicle.wheelbase * state.yaw_rate * math.sin(state.steer)
        return path / max(front, 1.0)


SPEED_WINDOW = 50
"""periods (0.5 s) over which wheels and IMU must agree on the change of speed"""
SPEED_CHANGE, SPEED_CHANGE_SHARE = 1.0, 0.11
"""m/s in that time: gravity on a 10 % grade (0.5), bias and noise; and a share of the speed: slip of all wheels that
comes or goes. Healthy drives come to 0.45 of both together"""


class SpeedChangeMonitor:
    """Change of the wheels' speed against the integral of the longitudinal specific force, over half a second."""

    def __init__(self) -> None:
        self.share = 0.0
        """of the bound that they disagree by now"""
        self._speeds: deque[float] = deque(maxlen=SPEED_WINDOW)
        self._forces: deque[float] = deque(maxlen=SPEED_WINDOW)
        self._held = ConditionTime()

    def step(self, now_ns: int, state: VehicleState, speed: float) -> float:
        """Seconds they have disagreed."""
        self._speeds.append(speed)
        self._forces.append(state.ax)
        if len(self._speeds) < SPEED_WINDOW or min(self._speeds) < JUDGED_FROM:
            self.share = 0.0
        else:
            by_imu = sum(self._forces) * PERIOD_S
            bound = SPEED_CHANGE + SPEED_CHANGE_SHARE * self._speeds[0]
            self.share = abs(self._speeds[-1] - self._speeds[0] - by_imu) / bound
        return self._held.update(self.share > 1.0, now_ns)
