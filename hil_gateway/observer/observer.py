"""Whether IMU and wheels fit the steering, engine and brakes of the car as it has been learnt."""

from __future__ import annotations

import math
from collections import deque

from hil_gateway.bus.messages import VehicleState
from hil_gateway.config import Config
from hil_gateway.observer import lateral, longitudinal
from hil_gateway.observer.bank import CHANCE, DOUBTED, GATE, SIGNS, SOUND
from hil_gateway.settings.gateway import PERIOD_S

SLOWEST = 10.0
"""m/s: slower, tyres answer within a period"""
ACTS_WITHIN = 25
"""periods in which engine and brakes act at last, by what they report"""


def _bound(chance: float) -> float:
    """What a chi-square with three degrees of freedom exceeds with this chance."""
    low, high = 0.0, 200.0
    for _ in range(60):
        x = 0.5 * (low + high)
        exceeded = math.erfc(math.sqrt(0.5 * x)) + math.sqrt(2.0 * x / math.pi) * math.exp(-0.5 * x)
        low, high = (x, high) if exceeded > chance else (low, x)
    return high


BOUND = _bound(CHANCE)


class Observer:
    """Once a period; what it finds is of this period."""

    def __init__(self, config: Config) -> None:
        car = config.car
        self._vehicle = car.vehicle
        self._per_pa = car.powertrain.brake_force_per_pa / car.vehicle.mass
        self._per_drive = car.powertrain.force_per_drive / car.vehicle.mass
        self._lateral, self._longitudinal = lateral.lateral_bank(car), longitudinal.longitudinal_bank(car)
        self._asked: deque[float] = deque(maxlen=ACTS_WITHIN)
        self._agree = False
        self.imu_off = 0.0
        """how far the IMU is off what the others predict, over what chance explains"""
        self.wheels_off = 0.0
        """the same of both axles' wheels, to one side of all the others"""

    @property
    def steer_zero(self) -> float:
        """Road-wheel angle beyond what is reported, rad; without what the IMU has shown in the last seconds."""
        return float(self._lateral.without.mean[lateral.ZERO])

    def step(self, state: VehicleState, speed: float, gravity_across: float, known: bool) -> None:
        """`speed` of the car, m/s; `gravity_across` as the map has it, m/s2; whether steering and tyres are what they
        are taken for."""
        pushing = max(state.drive, 0.0) * self._per_drive
        braking = (state.brake_front + state.brake_rear) * self._per_pa
        self._asked.append(pushing - braking)
        self.imu_off = self.wheels_off = 0.0
        self._agree = speed > SLOWEST and known and state.sources["steering"].valid and state.sources["pedals"].valid
        if not self._agree:
            self._lateral.pause()
            self._longitudinal.pause()
            return
        wheels, imu = state.sources["wheel_speeds"].valid, state.sources["imu"].valid
        speeds = state.wheel_speed_fl, state.wheel_speed_fr, state.wheel_speed_rl, state.wheel_speed_rr
        front, rear = lateral.rates_of_wheels(speeds, state.steer, self._vehicle)
        turning = lateral.LateralPeriod(
            PERIOD_S, speed, state.steer, braking, pushing, gravity_across, front, rear, state.yaw_rate, state.ay
        )
        changed = max(self._asked) - min(self._asked)
        self._lateral.step(turning, (wheels, wheels, True), imu)
        self._longitudinal.step(
            longitudinal.LongitudinalPeriod(PERIOD_S, braking, pushing, changed, speed, state.ax), (wheels,), imu
        )
        self._judge(wheels, imu)

    def _judge(self, wheels: bool, imu: bool) -> None:
        """The IMU where those that judge it agree; the wheels by all the others."""
        front, rear, *_ = self._lateral.without.off
        self._agree = imu and (not wheels or max(abs(front), abs(rear)) < GATE)
        self.imu_off = self._fits(SIGNS.index(SOUND)) if self._agree else 0.0
        if imu and self.imu_off * BOUND < DOUBTED:
            self._lateral.renew()
            self._longitudinal.renew()
        front, rear, *_ = self._lateral.main.off
        self.wheels_off = min(abs(front), abs(rear)) / GATE if wheels and front * rear > 0.0 else 0.0

    def _fits(self, which: int) -> float:
        """How far an IMU is off that has those of the signs, over what chance explains."""
        return (self._lateral.without.fits[which] + self._longitudinal.without.fits[which]) / BOUND

    def signs(self) -> tuple[float, float, float] | None:
        """Signs with which an IMU that is off would fit, where those that judge it agree."""
        if not self._agree or self.imu_off < 1.0:
            return None
        return next((signs for i, signs in enumerate(SIGNS) if self._fits(i) * BOUND < DOUBTED), None)
