"""Whether IMU and wheels fit the steering, engine and brakes of the car as it has been learnt."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

from hil_gateway.bus.messages import VehicleState
from hil_gateway.config import Config
from hil_gateway.observer import lateral, longitudinal
from hil_gateway.observer.axles import Axles, axles
from hil_gateway.observer.bank import CHANCE, DOUBTED, GATE
from hil_gateway.observer.steering import SteeringHypotheses
from hil_gateway.settings.gateway import PERIOD_S

SLOWEST = 10.0
"""m/s: slower, tyres answer within a period, noise turns the course of the fixes, and engine braking, clutch and creep
are as large as what is judged"""


def _bound(chance: float) -> float:
    """What a chi-square with three degrees of freedom exceeds with this chance."""
    low, high = 0.0, 200.0
    for _ in range(60):
        x = 0.5 * (low + high)
        exceeded = math.erfc(math.sqrt(0.5 * x)) + math.sqrt(2.0 * x / math.pi) * math.exp(-0.5 * x)
        low, high = (x, high) if exceeded > chance else (low, x)
    return high


BOUND = _bound(CHANCE)


def _lately(delay_s: float, deviation_s: float) -> deque[float]:
    """For what was reported since what hardly any car is later than."""
    return deque(maxlen=max(round((delay_s + 2.0 * deviation_s) / PERIOD_S), 1) + 1)


class Acts(NamedTuple):
    """What steering, brakes and engine do."""

    steer: float
    """road-wheel angle, rad"""
    braked_front: float
    """m/s2 by the brakes of an axle, as declared for their pressure"""
    braked_rear: float
    pushing: float
    """m/s2 by the engine, as declared"""

    @property
    def braking(self) -> float:
        """m/s2 by both brakes."""
        return self.braked_front + self.braked_rear


class Observer:
    """Once a period; what it finds is of this period, as shares of what chance explains."""

    def __init__(self, config: Config) -> None:
        car = config.car
        self._vehicle, self._fades = car.vehicle, car.tyres.load_sensitivity
        self._declared: list[float] = lateral.prior(car)[0].tolist()
        self._lateral, self._longitudinal = lateral.lateral_bank(car), longitudinal.longitudinal_bank(car)
        self.steering = SteeringHypotheses(car)
        self._asked = _lately(car.actuators.force_delay, car.std("actuators.force_delay"))
        """m/s2 by engine and brakes, of the time by which forces may be late"""
        self._steered = _lately(car.actuators.angle_delay, car.std("actuators.angle_delay"))
        """road-wheel angles of the time by which the wheels may be late, rad"""
        self.runs = False
        """whether the car is fast enough"""
        self._forget()

    def _forget(self) -> None:
        self.imu_off = self.wheel_off = self.speed_off = 0.0
        """how far the IMU is off what the others predict; one axle's wheels; the speed of the wheels"""

    @property
    def steer_zero(self) -> float:
        """Road-wheel angle beyond what is reported, rad; without what the IMU has shown in the last seconds."""
        return self._lateral.without.now[lateral.ZERO]

    @property
    def steer_late(self) -> float:
        """By which the road wheels follow the angle that is reported, as far as any car's do, s; without what the IMU
        has shown in the last seconds."""
        most = PERIOD_S * ((self._steered.maxlen or 1) - 1)
        return min(max(self._lateral.without.now[lateral.DELAY], 0.0), most)

    @property
    def slip(self) -> float:
        """Angle from where the car points to where it goes, rad; 0 where it is slow."""
        lane, _ = self.steering.told or (self._lateral.main, 0.0)
        return lane.now[lateral.VY] / self._turning.speed if self.runs else 0.0

    @property
    def axles(self) -> Axles | None:
        """Of the newest period, by all sources and the steering angle that is told; None where the car is slow."""
        if not self.runs:
            return None
        lane, beyond = self.steering.told or (self._lateral.main, 0.0)
        x: list[float] = list(lane.now)
        for tyre in (lateral.SF, lateral.SR, lateral.MUF, lateral.MUR):  # no slide shows tyres that give nothing
            x[tyre] = max(x[tyre], lateral.NOISE.least_left * self._declared[tyre])
        now = axles(self._vehicle, self._fades, x, self._turning)
        return now._replace(zero=now.zero - beyond)

    @property
    def yaw_rates(self) -> tuple[float, float]:
        """By all sources, and by all but the IMU, rad/s."""
        return self._lateral.main.now[lateral.R], self._lateral.without.now[lateral.R]

    def step(  # noqa: PLR0917 - what there is in a period
        self, state: VehicleState, speed: float, rolled: float, acts: Acts, gravity_across: float, imu: bool,
        judges: bool, steers: bool, angles: Sequence[float] | None = None,
    ) -> None:  # fmt: skip
        """`speed` of the car, and with which its wheels have `rolled`, m/s; `gravity_across` as the map has it, m/s2;
        whether the `imu` reports; whether what contradicts the rest `judges` it: steering, pedals and tyres are what
        they are taken for; whether the car `steers` as `acts` says; the road-wheel `angles` that it is asked for, None
        where it does not obey or nothing tells whether it does."""
        self._steered.append(acts.steer)
        self._asked.append(acts.pushing - acts.braking)
        self._forget()
        self.runs = speed > SLOWEST
        if not self.runs:
            self._lateral.pause()
            self._longitudinal.pause()
            self.steering.forget()
            return
        wheels, gain = state.sources["wheel_speeds"].valid, self._longitudinal.without.now[longitudinal.BRAKES]
        speeds = state.wheel_speed_fl, state.wheel_speed_fr, state.wheel_speed_rl, state.wheel_speed_rr
        front, rear = lateral.rates_of_wheels(speeds, acts.steer, self._vehicle)
        self._turning = turning = lateral.LateralPeriod(
            PERIOD_S, speed, acts.steer, self._steer_rate, gain * acts.braked_front, gain * acts.braked_rear,
            acts.pushing, gravity_across, front, rear, state.yaw_rate, state.ay, float(steers),
        )  # fmt: skip
        changed = max(self._asked) - min(self._asked)
        self._lateral.step(turning, (wheels, wheels, True), imu)
        if angles is None:
            self.steering.forget()
        else:
            self.steering.step(turning, angles, (wheels, wheels, True), self._lateral.main)
        self._longitudinal.step(
            longitudinal.LongitudinalPeriod(PERIOD_S, acts.braking, acts.pushing, changed, rolled, state.ax),
            (wheels,),
            imu,
        )
        if judges and steers:
            self._judge(wheels, imu)

    @property
    def _model_off(self) -> bool:
        """Whether the model of the tyres is off, as in a slide: with the IMU all fits, and the wheels fit better."""
        gains = self._lateral.without.gains + self._longitudinal.without.gains
        return gains > 0.0 and self._lateral.main.fit[0] + self._longitudinal.main.fit[0] < DOUBTED

    @property
    def _steer_rate(self) -> float:
        """Over the time by which the wheels may be late, rad/s."""
        steered = self._steered
        return (steered[-1] - steered[0]) / (PERIOD_S * max(len(steered) - 1, 1))

    def _judge(self, wheels: bool, imu: bool) -> None:
        """The IMU where those that judge it agree; the wheels by all the others."""
        front, rear, *_ = self._lateral.without.off
        agree = imu and (not wheels or max(abs(front), abs(rear)) < GATE)
        off = self._lateral.without.fit[0] + self._longitudinal.without.fit[0] if agree else 0.0
        self.imu_off = 0.0 if self._model_off else off / BOUND
        if imu and off < DOUBTED:
            self._lateral.renew()
            self._longitudinal.renew()
        if wheels:
            front, rear, *_ = self._lateral.main.off
            self.wheel_off = max(abs(front), abs(rear)) / GATE
            self.speed_off = abs(self._longitudinal.main.off[0]) / GATE
