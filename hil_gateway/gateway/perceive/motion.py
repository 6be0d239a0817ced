"""How the car moves, from whatever sensors are left: a stop must not go by the last value of a sensor that is gone."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

from hil_gateway.bus.messages import VehicleState
from hil_gateway.car.actuation import ActuatorPositions
from hil_gateway.car.car import Car
from hil_gateway.gateway.perceive.course import COURSE_WINDOW, Course
from hil_gateway.gateway.perceive.duration import UNSEEN_S
from hil_gateway.gateway.perceive.fading_ratio import LEARNT, FadingRatio
from hil_gateway.gateway.perceive.gyro_repair import GyroRepair, RepairedGyro
from hil_gateway.observer.bank import RENEWED_S
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.settings.gateway import PERIOD_S

MOST_GRIP = 1.6
"""friction that no tyres exceed: what they slow a car down by with its downforce and drag at its fastest is the most.
Wheels that slow down faster have locked"""
MISMATCH_S = 5.0
"""s: how slowly the difference of the rear wheels' radii is learnt from the gyro, so that no bend is taken for one"""
LEARNING_FROM = 10.0
"""m/s from which that difference shows"""
UNDERSTEER = 1e-3
"""rad per m/s2 of lateral force before anything has been learnt: a racing car at moderate lateral force"""
UNDERSTEER_MOST = 2.0 * UNDERSTEER
"""a car that turns at 80 m/s a fifth of what its steering angle means; the other way as much as the expected one, where
the front tyres are a quarter better than the rear ones under the brakes"""
SHORTEST_SHARE = 0.4
"""of the wheelbase at least that a car turns as if it had: one that oversteers more is not steady"""
BRAKED_UNDERSTEER = 0.5
"""of the understeer is left under the brakes: they load the front axle, and it was learnt mostly under power"""
BRAKE_SLIP = 0.0025
"""slip of the second fastest wheel a m/s2 of braking: slicks under a car of 1.5 g of
downforce; in 300 m of braking it adds up to several metres"""
BRAKED = 3.0
"""m/s2 by the brakes above which the load that they shift shows"""
POWERED = 0.02
"""slip-ratio drive command from which the engine may spin the driven wheels"""
SPIN_LEAST = 0.6
"""front over rear wheels' speed: driven wheels do not spin by more than two thirds; less is a dead front sensor"""
TURNED_S = 0.04
"""time constant, s: noise of the wheel speeds (0.3 % of a sample, 0.1 rad/s at 50 m/s)"""
WHEELS_SHARE = 0.5
"""of what the wheels say of a change, beside the steering: where brakes press, inner wheels slip and show up to twice
the turn; in a slide the steering shows less than there is, or the other way"""
LEAST_AHEAD = 0.8
"""front over rear axle's speed: with 0.3 rad of steering 0.96 and more; less is a wrong yaw rate"""


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
    prompt: bool = True
    """whether the yaw rate is that of now: the gyro's, or one that the wheels have told the changes of"""
    by_wheels: bool = True
    """whether the speed is that of the wheels"""
    repaired: bool = False
    """whether the gyro is one with what it is wrong by taken back: the rest of that adds up, and fixes correct it"""


class Judged(NamedTuple):
    """What the monitors think of the sensors."""

    imu: bool = True
    wheels: bool = True
    """false when other sensors contradict them"""
    imu_wrong: bool = False
    """whether the IMU is contradicted, and not only gone: the last it has taught may be wrong, too"""
    repair: GyroRepair | None = None
    """what makes a gyro that is not believed right again, where that is known"""
    steer_zero: float = 0.0
    """road-wheel angle beyond what is reported, rad"""
    stopping: bool = False
    """whether the car is being stopped: a slide teaches nothing of how it turns under the brakes"""


class _Taught(NamedTuple):
    """What the IMU has taught."""

    understeer: float
    """rad of steering angle a m/s2 of lateral force, lately"""
    braked: float
    """the same under the brakes"""


class MotionReader:
    """Picks, every period, the best source that is valid.

    Speed: the second fastest wheel (one sensor may be wrong), at the centre of gravity and with the slip that brakes
    make, held against locking by what tyres can do; without wheels that of the fixes, then the IMU carries it
    on. Yaw rate: the gyro, also one that failed in a known way, with that taken back; without it the turn rate of the
    fixes' course, then the rear wheels' difference (which
    braking falsifies), then v tan(delta) / (L + K v^2) with the understeer K that the gyro has taught. Turn rates are
    late by half the time they span: what has changed since then is added, half of it by the differences of the wheels
    (under the brakes up to twice what it is) and half by the steering; by the steering alone without wheels.
    Lateral force without an IMU: by that yaw rate, or by the steering where that is more, which is not late: brakes
    leave grip for it. Where nothing reports any more, what stands on the wire is taken for done.
    """

    def __init__(self, car: Car) -> None:
        self._vehicle = vehicle = car.vehicle
        self._per_pa = car.powertrain.brake_force_per_pa / vehicle.mass
        fastest, self._turns_in_s = car.actuators.speed_max, car.turns_in_s
        self._turning_most = MOST_GRIP * vehicle.pressed(fastest)
        """m/s2 of lateral force: wheels whose difference means more have locked"""
        self._slowing_most = self._turning_most + vehicle.drag(fastest)
        self._lately, self._under_brakes = (
            FadingRatio(LEARNT, UNDERSTEER, 1.0),
            FadingRatio(LEARNT),
        )
        """steering angle beyond that of a slow car over lateral force, rad a m/s2"""
        self._taught: deque[_Taught] = deque([self._teaches()], maxlen=round(RENEWED_S / PERIOD_S))
        """of the last periods with an IMU, as long as one that the observer finds wrong may have taught wrongly"""
        self._mismatch_front = self._mismatch = 0.0
        """(right - left) / (track v) on a straight, 1/m"""
        self._last_ns: int | None = None
        self._steered: deque[float] = deque(maxlen=COURSE_WINDOW)
        """v tan(delta) / L of the periods a course spans, rad/s"""
        self._asked: deque[float] = deque(maxlen=periods_late(car))
        """steering angles on the wire, rad at the motor, the oldest of which the steering has reached"""
        self._meant: deque[float] = deque(maxlen=COURSE_WINDOW)
        """the same by what stood on the wire, as far as the steering has reached it"""
        self._turned: deque[float] = deque(maxlen=COURSE_WINDOW)
        """yaw rates by the wheels of both axles in those periods, rad/s; none where one of them has said nothing"""
        self.motion = Motion()
        self.judged = Judged()
        self._repaired = RepairedGyro()

    def step(
        self, now_ns: int, state: VehicleState, course: Course | None = None, commanded: ActuatorPositions | None = None
    ) -> Motion:
        """Motion at `now_ns`; once a period. `course` is that of the position fixes, where they are believed;
        `commanded` stands on the wire, None where nothing is sent."""
        dt = 0.0 if self._last_ns is None else min(max((now_ns - self._last_ns) / NS_PER_S, 0.0), UNSEEN_S)
        self._last_ns = now_ns
        imu = state.sources["imu"].valid and self.judged.imu
        wheels = state.sources["wheel_speeds"].valid and self.judged.wheels
        speed = self._speed(state, imu, wheels, dt, course, commanded)
        self._asked.append(0.0 if commanded is None else commanded.steering_motor)
        steered = self._steered_rate(state, speed, commanded)
        if imu and wheels and speed > LEARNING_FROM:
            self._learn(state, speed)
        share = dt / (dt + self._turns_in_s * speed + 1e-9)
        meant = self._turn_of(self._asked[0] / self._vehicle.steering_ratio, state, speed, commanded)
        for turns, rate in (self._steered, steered), (self._meant, meant):
            before = turns[-1] if turns else rate
            turns.append(before + share * (rate - before))
        self._note_turn(state, speed, wheels, dt)
        if imu and wheels and speed > LEARNING_FROM:
            share = min(dt / MISMATCH_S, 1.0)
            front, rear = self._front_difference(state), self._rear_difference(state)
            self._mismatch_front += share * ((front - state.yaw_rate) / speed - self._mismatch_front)
            self._mismatch += share * ((rear - state.yaw_rate) / speed - self._mismatch)
        return self._move(state, speed, course)

    def again(self, state: VehicleState, course: Course | None) -> Motion:
        """Motion of the present period once more: sensors have been found wrong since `step`."""
        return self._move(state, self.motion.speed, course)

    def _move(self, state: VehicleState, speed: float, course: Course | None) -> Motion:
        imu = state.sources["imu"].valid and self.judged.imu
        wheels = state.sources["wheel_speeds"].valid and self.judged.wheels
        inertial = (state.yaw_rate, state.ay) if imu else self._by_repair(state, speed, course)
        yaw_rate = self._without_gyro(state, speed, wheels, course) if inertial is None else inertial[0]
        force = speed * max(yaw_rate, self._steered[-1], key=abs) if inertial is None else inertial[1]
        by_gyro = inertial is not None
        prompt = by_gyro or (course is not None and self._wheels_tell)
        repaired = by_gyro and not imu
        self.motion = Motion(speed, yaw_rate, force, by_gyro, self._learnt.understeer, prompt, wheels, repaired)
        return self.motion

    @property
    def steered(self) -> float:
        """Yaw rate that the steering angle comes to by now, rad/s."""
        return self._steered[-1] if self._steered else 0.0

    def turned_within(self, seconds: float) -> float:
        """By how much the yaw rate has changed lately by what stood on the wire, rad/s; `COURSE_WINDOW` at most."""
        meant = list(self._meant)[-1 - round(seconds / PERIOD_S) :]
        return meant[-1] - meant[0] if meant else 0.0

    def rear_yaw_rate(self, state: VehicleState, speed: float) -> float:
        """Yaw rate the rear wheels' difference means, rad/s."""
        return self._rear_difference(state) - self._mismatch * speed

    def front_yaw_rate(self, state: VehicleState, speed: float) -> float:
        """Yaw rate the front wheels' difference means, rad/s."""
        return self._front_difference(state) - self._mismatch_front * speed

    def wheel_yaw_rate(self, state: VehicleState, speed: float) -> float:
        """Yaw rate by the axle that the engine does not drive now: under power an inner rear wheel slips, rad/s."""
        if state.drive > POWERED:
            return self.front_yaw_rate(state, speed)
        return self.rear_yaw_rate(state, speed)

    def _steered_rate(self, state: VehicleState, speed: float, commanded: ActuatorPositions | None) -> float:
        """Yaw rate that the steering angle comes to, by its sensor or else its command, rad/s."""
        reported = state.sources["steering"].valid
        steer = state.steer if reported else self._asked[0] / self._vehicle.steering_ratio
        return self._turn_of(steer, state, speed, commanded)

    def _turn_of(self, steer: float, state: VehicleState, speed: float, commanded: ActuatorPositions | None) -> float:
        """Yaw rate that a road-wheel angle comes to, rad/s."""
        learnt, length = self._learnt, self._vehicle.wheelbase
        understeer = learnt.braked if self._braked(state, commanded) > BRAKED else learnt.understeer
        length = max(length + understeer * speed**2, SHORTEST_SHARE * length)
        return speed * math.tan(steer + self.judged.steer_zero) / length

    @property
    def _learnt(self) -> _Taught:
        """What to go by."""
        return self._taught[0 if self.judged.imu_wrong else -1]

    def _learn(self, state: VehicleState, speed: float) -> None:
        """What a stop without an IMU goes by."""
        beyond = math.tan(state.steer + self.judged.steer_zero) - self._vehicle.wheelbase * state.yaw_rate / speed
        self._lately.learn(beyond, state.ay)
        if self._pressed(state) > BRAKED and not self.judged.stopping:
            self._under_brakes.learn(beyond, state.ay)
        self._taught.append(self._teaches())

    def _teaches(self) -> _Taught:
        understeer = min(max(self._lately.alone, 0.0), UNDERSTEER_MOST)
        braked = self._under_brakes.ratio(BRAKED_UNDERSTEER * understeer)
        return _Taught(understeer, min(max(braked, -UNDERSTEER), UNDERSTEER_MOST))

    def _speed(  # noqa: PLR0917 - what it is taken from
        self, state: VehicleState, imu: bool, wheels: bool, dt: float, course: Course | None,
        commanded: ActuatorPositions | None,
    ) -> float:  # fmt: skip
        if wheels:
            by_wheels = self._second_fastest(state) * (1.0 + BRAKE_SLIP * self._braked(state, commanded))
            return max(by_wheels, self.motion.speed - self._slowing_most * dt)
        if course is not None:
            return course.speed
        gain = state.ax if imu else -self._braking(commanded)
        return max(self.motion.speed + gain * dt, 0.0)

    def _second_fastest(self, state: VehicleState) -> float:
        """Speed of the second fastest wheel at the centre of gravity, m/s: in a bend outer wheels go further, and front
        wheels as far as their axle."""
        car, turn = self._vehicle, self.motion.yaw_rate
        front, rear = 0.5 * car.track_front * turn, 0.5 * car.track_rear * turn
        ahead = math.cos(state.steer)
        if self.motion.speed > LEARNING_FROM:
            ahead += car.wheelbase * turn * math.sin(state.steer) / self.motion.speed
        ahead = max(ahead, LEAST_AHEAD)
        fl, fr, rl, rr = wheel_speeds(state)
        return max(_not_spinning((fl / ahead + front, fr / ahead - front, rl + rear, rr - rear), state.drive), 0.0)

    def _braked(self, state: VehicleState, commanded: ActuatorPositions | None) -> float:
        """Deceleration by the brakes as they are reported, else as they are asked for, m/s2."""
        return self._pressed(state) if state.sources["pedals"].valid else self._braking(commanded)

    def _pressed(self, state: VehicleState) -> float:
        """Deceleration by the brakes as they are reported, m/s2."""
        return (state.brake_front + state.brake_rear) * self._per_pa

    def _braking(self, commanded: ActuatorPositions | None) -> float:
        """Deceleration by the brakes that are asked for and by drag, m/s2; 0 where nothing is sent."""
        if commanded is None or commanded.accelerator > 0.0:
            return 0.0
        return (commanded.brake_front + commanded.brake_rear) * self._per_pa + self._vehicle.drag(self.motion.speed)

    def _by_repair(self, state: VehicleState, speed: float, course: Course | None) -> tuple[float, float] | None:
        """Yaw rate (rad/s) and lateral specific force (m/s2) of an IMU that has a repair."""
        reading = state.yaw_rate if state.sources["imu"].valid else None
        repair = self.judged.repair
        yaw_rate = self._repaired.step(repair, reading, course)
        if yaw_rate is None or repair is None:
            return None
        return yaw_rate, repair.force * state.ay if repair.force else speed * yaw_rate

    def _without_gyro(self, state: VehicleState, speed: float, wheels: bool, course: Course | None) -> float:
        if course is not None:
            share = WHEELS_SHARE if self._wheels_tell else 0.0
            steered, turned = _since_mean(self._steered), _since_mean(self._turned)
            return course.turn_rate + share * turned + (1.0 - share) * steered
        return self.rear_yaw_rate(state, speed) if wheels else self._steered[-1]

    @property
    def _wheels_tell(self) -> bool:
        """Whether the wheels have told how the car turns in all periods a course spans."""
        return len(self._turned) == COURSE_WINDOW

    def _note_turn(self, state: VehicleState, speed: float, wheels: bool, dt: float) -> None:
        """Yaw rate that the differences of both axles' wheels mean; what they are wrong by all the time does not
        matter."""
        if not wheels:
            self._turned.clear()
            return
        most = self._turning_most / max(speed, LEARNING_FROM)
        now = min(max(0.5 * (self._front_difference(state) + self._rear_difference(state)), -most), most)
        before = self._turned[-1] if self._turned else now
        self._turned.append(before + dt / (dt + TURNED_S) * (now - before))

    def _front_difference(self, state: VehicleState) -> float:
        return (state.wheel_speed_fr - state.wheel_speed_fl) / self._vehicle.track_front

    def _rear_difference(self, state: VehicleState) -> float:
        return (state.wheel_speed_rr - state.wheel_speed_rl) / self._vehicle.track_rear


def _since_mean(rates: deque[float]) -> float:
    """By how much the newest differs from the mean of all, rad/s; 0 where there is none."""
    return rates[-1] - sum(rates) / len(rates) if rates else 0.0


def wheel_speeds(state: VehicleState) -> tuple[float, float, float, float]:
    """Front left, front right, rear left, rear right, m/s."""
    return state.wheel_speed_fl, state.wheel_speed_fr, state.wheel_speed_rl, state.wheel_speed_rr


def second_fastest(state: VehicleState) -> float:
    """Speed of the second fastest wheel, m/s, that does not spin: one sensor may be wrong either way."""
    return _not_spinning(wheel_speeds(state), state.drive)


def _not_spinning(speeds: tuple[float, float, float, float], drive: float) -> float:
    """Second fastest of the speeds (fl, fr, rl, rr), m/s; under power both driven wheels may be faster than the car."""
    second, front = sorted(speeds)[-2], max(speeds[:2])
    return front if drive > POWERED and SPIN_LEAST * second < front < second else second
