"""How the car moves, from whatever sensors are left: a stop must not go by the last value of a sensor that is gone."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from hil_gateway.bus.messages import VehicleState
from hil_gateway.car.actuation import ActuatorPositions
from hil_gateway.car.car import Car
from hil_gateway.car.states import STEERS
from hil_gateway.gateway.perceive.course import COURSE_WINDOW, Course
from hil_gateway.gateway.perceive.duration import UNSEEN_S
from hil_gateway.gateway.perceive.fading_ratio import FadingRatio
from hil_gateway.gateway.perceive.road_speed import Wheels, at_the_middle, wheel_speeds
from hil_gateway.observer.axles import Axles
from hil_gateway.observer.bank import DOUBTED, RENEWED_S
from hil_gateway.observer.longitudinal import slipped
from hil_gateway.observer.observer import SLOWEST, Acts, Observer
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.settings.gateway import PERIOD_S

UNDERSTEER = 1e-3
"""rad per m/s2 of lateral force before anything has been learnt: a racing car at moderate lateral force"""
UNDERSTEER_MOST = 2.0 * UNDERSTEER
"""a car that turns at 80 m/s a fifth of what its steering angle means; the other way as much as the expected one, where
the front tyres are a quarter better than the rear ones under the brakes"""
BRAKED_UNDERSTEER = 0.5
"""of the understeer is left under the brakes: they load the front axle, and it was learnt mostly under power"""
BRAKED = 5.0
"""m/s2 by the brakes above which the car shows that it brakes: it slows down, and its load shifts"""
SHORTEST_SHARE = 0.4
"""of the wheelbase at least that a car turns as if it had: one that oversteers more is not steady"""
SPIN_LEAST = 0.6
"""front over rear wheels' speed: driven wheels do not spin by more than two thirds; less is a dead front sensor"""
LEARNT = PERIOD_S / RENEWED_S
"""weight of a period: what is learnt is as old as what the observer judges an IMU by"""
ANSWER = 2
"""times delay, lag and report of the steering within which it need not have answered yet"""


def periods_late(car: Car) -> int:
    """That the steering is behind its command, by its report of a period later."""
    return 1 + round(car.actuators.steering_late / PERIOD_S)


class Motion(NamedTuple):
    """Speed (m/s, forward), yaw rate (rad/s, left), lateral specific force (m/s2, left); none from a source that is
    invalid."""

    speed: float = 0.0
    yaw_rate: float = 0.0
    ay: float = 0.0
    by_gyro: bool = True
    """whether the yaw rate is the gyro's; a substitute drifts, and fixes correct the heading"""
    understeer: float = 0.0
    """rad of steering angle a m/s2 of lateral force, as the gyro has taught it"""
    late_s: float = 0.0
    """s since the yaw rate was reported, of which only changes are known since; infinite where they are not either"""
    by_wheels: bool = True
    """whether the speed is that of the wheels"""
    slip: float = 0.0
    """rad from where the car points to where it goes, as the observer has it; 0 without a gyro"""


class Judged(NamedTuple):
    """What the monitors think of sensors, tyres and steering."""

    imu_wrong: bool = False
    wheels: bool = True
    """false when other sensors contradict them"""
    imu_gone: bool = False
    """whether the IMU was not there during all of a stop"""
    tyres: bool = True
    """whether none is flat"""
    steers: bool = True
    """whether the steering does what it reports"""
    stopping: bool = False
    """whether the car is being stopped"""
    gravity_across: float = 0.0
    """on the bank where the car is, m/s2"""


class _Taught(NamedTuple):
    """Steering angle beyond that of a slow car over lateral force, rad a m/s2: lately, and under the brakes."""

    understeer: float
    braked: float


class MotionReader:
    """Picks, every period, the best source that is valid.

    Speed: the second fastest wheel (one sensor may be wrong), at the centre of gravity and with the slip that brakes
    make, held against locking by what tyres can do; without wheels that of the fixes, then the IMU carries it on. Yaw
    rate: the gyro; without it the turn rate of the fixes' course, late by half the time it spans, with what has changed
    since then by the observer, which does without the IMU; without fixes that of the observer; without wheels, or below
    its speed, v tan(delta) / (L + K v^2) with the understeer K that the gyro has taught. Where nothing reports any
    more, what stands on the wire is taken for done.
    """

    def __init__(self, car: Car, observer: Observer) -> None:
        self._vehicle, self._observer = car.vehicle, observer
        per_pa, share = 2.0 * car.powertrain.brake_force_per_pa / car.vehicle.mass, car.powertrain.brake_share_front
        self._per_pa = per_pa * share, per_pa * (1.0 - share)
        """m/s2 of the brakes of front and rear axle"""
        self._per_drive = car.powertrain.force_per_drive / car.vehicle.mass
        fastest = car.actuators.speed_max
        self._slowing_most = car.most_grip * car.vehicle.pressed(fastest) + car.vehicle.drag(fastest)
        """m/s2: wheels that slow down faster have locked"""
        self._turn_in = car.turn_in
        self._lately, self._under_brakes = FadingRatio(LEARNT, UNDERSTEER, 1.0), FadingRatio(LEARNT)
        self._taught: deque[_Taught] = deque([self._teaches()], maxlen=round(RENEWED_S / PERIOD_S))
        """of the last periods with an IMU, as long as one that the observer finds wrong may have taught wrongly"""
        self._least_ahead = math.cos(car.actuators.steering_range)
        """front over rear axle's speed of a car that does not spin; less is a wrong yaw rate"""
        self._steered = 0.0
        """yaw rate that the steering comes to by now, rad/s"""
        self._last_ns: int | None = None
        self._late = periods_late(car)
        kept = ANSWER * self._late + round(UNSEEN_S / PERIOD_S)
        self._asked: deque[float] = deque([0.0] * kept, maxlen=kept)
        """steering angles on the wire, rad at the motor: any steering has reached the oldest that late frames say"""
        self._observed: deque[tuple[float, float, float]] = deque(maxlen=COURSE_WINDOW)
        """yaw rates by the observer in the periods a course spans, by it without the IMU and by the gyro, rad/s"""
        self.motion = Motion()
        self.judged = Judged()

    def step(
        self, now_ns: int, state: VehicleState, course: Course | None = None, commanded: ActuatorPositions | None = None
    ) -> Motion:
        """Motion at `now_ns`; once a period. `course` is that of the position fixes, where they are believed;
        `commanded` stands on the wire, None where nothing is sent."""
        dt = 0.0 if self._last_ns is None else min(max((now_ns - self._last_ns) / NS_PER_S, 0.0), UNSEEN_S)
        self._last_ns = now_ns
        self._asked.append(0.0 if commanded is None else commanded.steering_motor)
        acts = self._acts(state, commanded)
        slip = slipped(acts.braking, self._vehicle.pressed(self.motion.speed))
        rolled = self._second_fastest(state) * (1.0 + slip)
        speed = self._speed(state, dt, rolled, acts, course, commanded)
        self._observe(state, speed, rolled, acts, commanded)
        if self._gyro(state) and self._wheels(state) and speed > SLOWEST:
            self._learn(state, speed, acts)
        self._steered += self._turn_in.follows(dt, speed) * (self._turn_of(acts, speed) - self._steered)
        return self._move(state, speed, course)

    @property
    def steer_late(self) -> float:
        """By which the road wheels follow the reported angle, s, as driving has shown."""
        return self._observer.steer_late

    def again(self, state: VehicleState, course: Course | None) -> Motion:
        """Motion of the present period once more: sensors have been found wrong since `step`."""
        return self._move(state, self.motion.speed, course)

    def axles(self, late_s: float, mirrored: bool) -> Axles | None:
        """When what is asked for now is answered; None where the car is slow, or how it turns is not known. `late_s`:
        how late all frames are; `mirrored`: whether the steering goes to the other side than its command."""
        now = self._observer.axles if self.motion.by_gyro else None
        if now is None:
            return None
        ratio = self._vehicle.steering_ratio * (-1.0 if mirrored else 1.0)
        angles = [angle / ratio for angle in self._asked]
        answered = len(angles) + 1 - self._late
        unheard = max(answered - round(late_s / PERIOD_S), 0)
        return now.onward(angles[unheard:answered]).onward(angles[answered:])

    def turned_within(self, seconds: float) -> float:
        """By how much the yaw rate has changed lately by the observer, rad/s; `COURSE_WINDOW` at most."""
        turned = self._turned[-1 - round(seconds / PERIOD_S) :]
        return turned[-1] - turned[0] if turned else 0.0

    def fixes_favour_gyro(self, course: Course) -> bool:
        """Whether the car has turned, by its fixes, as the gyro says rather than as the observer says without it."""
        if len(self._observed) < COURSE_WINDOW:
            return False
        _, without, gyro = np.mean(self._observed, axis=0) - course.turn_rate
        return bool(without**2 - gyro**2 > DOUBTED * course.turn_std**2)

    def _gyro(self, state: VehicleState) -> bool:
        return state.sources["imu"].valid and not (self.judged.imu_wrong or self.judged.imu_gone)

    def _wheels(self, state: VehicleState) -> bool:
        return state.sources["wheel_speeds"].valid and self.judged.wheels

    def _acts(self, state: VehicleState, commanded: ActuatorPositions | None) -> Acts:
        """As reported, else as asked for."""
        reported = state.sources["steering"].valid
        steer = state.steer if reported else self._asked[-self._late] / self._vehicle.steering_ratio
        if state.sources["pedals"].valid:
            return Acts(steer, *self._braked(state), max(state.drive, 0.0) * self._per_drive)
        return Acts(steer, *(self._braked(commanded) if commanded else (0.0, 0.0)), 0.0)

    def _braked(self, pressures: VehicleState | ActuatorPositions) -> tuple[float, float]:
        front, rear = self._per_pa
        return pressures.brake_front * front, pressures.brake_rear * rear

    def _observe(
        self, state: VehicleState, speed: float, rolled: float, acts: Acts, commanded: ActuatorPositions | None
    ) -> None:
        judged, sources = self.judged, state.sources
        imu = sources["imu"].valid and not judged.imu_gone
        known = sources["steering"].valid and sources["pedals"].valid and not judged.imu_gone and judged.tyres
        obeys = commanded is not None and state.sys_state in STEERS and known and self._gyro(state)
        angles = [self._asked[-late] / self._vehicle.steering_ratio for late in (self._late, ANSWER * self._late)]
        self._observer.step(
            state, speed, rolled, acts, judged.gravity_across, imu, known, judged.steers, angles if obeys else None,
        )  # fmt: skip
        if self._observer.runs:
            self._observed.append((*self._observer.yaw_rates, state.yaw_rate))
        else:
            self._observed.clear()

    @property
    def _turned(self) -> list[float]:
        """Yaw rates by the observer, rad/s: not with what an IMU has said that is wrong."""
        return [rates[self.judged.imu_wrong] for rates in self._observed]

    def _move(self, state: VehicleState, speed: float, course: Course | None) -> Motion:
        gyro = self._gyro(state)
        yaw_rate = state.yaw_rate if gyro else self._without_gyro(state, course)
        told = gyro or (course is not None and len(self._observed) == COURSE_WINDOW)
        force = state.ay if gyro else speed * yaw_rate
        self.motion = Motion(
            speed, yaw_rate, force, gyro, self._learnt.understeer, 0.0 if told else math.inf, self._wheels(state),
            self._observer.slip if gyro else 0.0,
        )  # fmt: skip
        return self.motion

    def _without_gyro(self, state: VehicleState, course: Course | None) -> float:
        turned = self._turned
        if course is not None:
            since = turned[-1] - sum(turned) / COURSE_WINDOW if len(turned) == COURSE_WINDOW else 0.0
            return course.turn_rate + since
        return turned[-1] if turned and self._wheels(state) else self._steered

    def _turn_of(self, acts: Acts, speed: float) -> float:
        """Yaw rate that steering and brakes come to, rad/s."""
        length = self._vehicle.wheelbase
        understeer = self._learnt.braked if acts.braking > BRAKED else self._learnt.understeer
        length = max(length + understeer * speed**2, SHORTEST_SHARE * length)
        return speed * math.tan(acts.steer + self._observer.steer_zero) / length

    @property
    def _learnt(self) -> _Taught:
        """What to go by."""
        return self._taught[0 if self.judged.imu_wrong else -1]

    def _learn(self, state: VehicleState, speed: float, acts: Acts) -> None:
        """What a stop without an IMU goes by; a slide teaches nothing of how the car turns under the brakes."""
        steer = state.steer + self._observer.steer_zero
        beyond = math.tan(steer) - self._vehicle.wheelbase * state.yaw_rate / speed
        self._lately.learn(beyond, state.ay)
        if acts.braking > BRAKED and not self.judged.stopping:
            self._under_brakes.learn(beyond, state.ay)
        self._taught.append(self._teaches())

    def _teaches(self) -> _Taught:
        understeer = min(max(self._lately.alone, 0.0), UNDERSTEER_MOST)
        braked = self._under_brakes.ratio(BRAKED_UNDERSTEER * understeer)
        return _Taught(understeer, min(max(braked, -UNDERSTEER), UNDERSTEER_MOST))

    def _speed(  # noqa: PLR0917 - what it is taken from
        self, state: VehicleState, dt: float, rolled: float, acts: Acts, course: Course | None,
        commanded: ActuatorPositions | None,
    ) -> float:  # fmt: skip
        if self._wheels(state):
            return max(rolled, self.motion.speed - self._slowing_most * dt)
        if course is not None:
            return course.speed
        rolls = commanded is not None and commanded.accelerator <= 0.0
        slows = acts.braking + self._vehicle.drag(self.motion.speed) if rolls else 0.0
        return max(self.motion.speed + (state.ax if self._gyro(state) else -slows) * dt, 0.0)

    def _second_fastest(self, state: VehicleState) -> float:
        """Speed of the second fastest wheel at the centre of gravity, m/s: front wheels go as far as their axle."""
        car, turn = self._vehicle, self.motion.yaw_rate
        ahead = math.cos(state.steer)
        if self.motion.speed > SLOWEST:
            ahead += car.wheelbase * turn * math.sin(state.steer) / self.motion.speed
        ahead = max(ahead, self._least_ahead)
        fl, fr, rl, rr = at_the_middle(state, car, turn)
        return max(_not_spinning((fl / ahead, fr / ahead, rl, rr), state.drive), 0.0)


def second_fastest(state: VehicleState) -> float:
    """Speed of the second fastest wheel, m/s, that does not spin: one sensor may be wrong either way."""
    return _not_spinning(wheel_speeds(state), state.drive)


def _not_spinning(speeds: Wheels, drive: float) -> float:
    """Second fastest of the speeds (fl, fr, rl, rr), m/s; under power both driven wheels may be faster than the car."""
    second, front = sorted(speeds)[-2], max(speeds[:2])
    return front if drive > 0.0 and SPIN_LEAST * second < front < second else second
