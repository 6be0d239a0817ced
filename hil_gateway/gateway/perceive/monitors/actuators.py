"""Actuators against their commands: reported positions, and the acceleration that follows from them."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

import numpy as np

from hil_gateway.bus.messages import VehicleState
from hil_gateway.car.actuation import ActuatorPositions
from hil_gateway.car.car import Car
from hil_gateway.gateway.perceive.duration import ConditionTime
from hil_gateway.gateway.perceive.motion import ANSWER, BRAKED, periods_late
from hil_gateway.observer.bank import GATE, RENEWED_S
from hil_gateway.observer.numbers import sound_imu_within
from hil_gateway.observer.observer import SLOWEST
from hil_gateway.observer.steering import SteeringHypotheses
from hil_gateway.process.arrays import Array
from hil_gateway.settings.gateway import PERIOD_S

WINDOW = 4
"""times delay, lag and report of the steering of whose commands one has been reached: five time constants"""
PEDALS = 0.12
"""of the full accelerator, and of the full pressure of a brake: scatter of pads and lines"""
BRAKED_SHARE = 0.3
"""of what was commanded: cars with hot brakes, wet tyres and an unequal balance do better"""


class SteeringReports:
    """What reports of the steering may differ by: angles at the motor, rad; periods."""

    def __init__(self, car: Car) -> None:
        self.ratio, self.late = car.vehicle.steering_ratio, periods_late(car)
        self.still = car.sensors.steering_noise
        """within which a sensor stays that does not move"""
        self.asked = GATE * self.still
        """by which a command must change until steering that works has moved: play, overshoot"""
        self.apart = car.std("sensors.steering_offset") + self.asked + self.still
        """how far it may be off with the offset of its sensor"""
        self.answer, self.window = ANSWER * self.late, WINDOW * self.late


class _StandingSteering:
    """Steering that has not moved since some moment, although its commands from then on asked it to."""

    def __init__(self, steering: SteeringReports) -> None:
        self._steering = steering
        self._low = self._high = math.nan
        self._unanswered: deque[float] = deque()
        self._least, self._most = math.inf, -math.inf
        """of the commands since then that had time to be answered"""

    def step(self, reported: float, asked: float) -> None:
        """Angles at the motor, rad; once a period."""
        self._low, self._high = min(self._low, reported), max(self._high, reported)
        if not self._high - self._low <= self._steering.still:
            self._low = self._high = reported
            self._unanswered.clear()
            self._least, self._most = math.inf, -math.inf
        self._unanswered.append(asked)
        if len(self._unanswered) > self._steering.answer:
            answered = self._unanswered.popleft()
            self._least, self._most = min(self._least, answered), max(self._most, answered)

    @property
    def found(self) -> bool:
        """Whether it stands still against its commands."""
        return self._most - self._least > self._steering.asked


class FollowingMonitor:
    """Reported positions within the commands of a window, and moving with them; reports that are invalid say nothing of
    actuators."""

    def __init__(self, car: Car) -> None:
        self._of = SteeringReports(car)
        self._brakes = PEDALS * car.powertrain.brake_pressure_max
        self._commands: deque[ActuatorPositions] = deque(maxlen=self._of.window)
        self.obeyed: Sequence[ActuatorPositions] = ()
        """all commands of a window, which the car has had to obey"""
        self._standing = _StandingSteering(self._of)
        self._steering, self._pedals = ConditionTime(), ConditionTime()

    def step(
        self, now_ns: int, state: VehicleState, commanded: ActuatorPositions | None, against: bool, told: bool
    ) -> tuple[float, float]:
        """How long what steering and pedals report has been outside of their commands, or the steering moves `against`
        its own, s. `commanded` stands on the wire; None while nothing is sent or the car does not obey. Whether it is
        `told` that the car turns by its command and not by its report, or the reverse: then no offset excuses it."""
        if commanded is None:
            self._commands.clear()
            self._standing = _StandingSteering(self._of)
        else:
            self._commands.append(commanded)
            self._standing.step(state.steer * self._of.ratio, commanded.steering_motor)
        full = len(self._commands) == self._of.window
        self.obeyed = self._commands if full else ()
        motor = state.steer * self._of.ratio
        steers = full and state.sources["steering"].valid
        apart = 0.0 if told else self._of.apart
        steers = steers and (against or self._standing.found or self._outside(motor, "steering_motor", apart))
        pedals = full and state.sources["pedals"].valid
        pedals = pedals and (
            self._outside(state.brake_front, "brake_front", self._brakes)
            or self._outside(state.brake_rear, "brake_rear", self._brakes)
            or self._outside(state.accelerator, "accelerator", PEDALS)
        )
        return self._steering.update(steers, now_ns), self._pedals.update(pedals, now_ns)

    def _outside(self, reported: float, actuator: str, tolerance: float) -> bool:
        newest: float = getattr(self._commands[-1], actuator)
        if newest - tolerance <= reported <= newest + tolerance:
            return False  # as it nearly always is: the others can only widen the range
        commands = [getattr(command, actuator) for command in self._commands]
        return not min(commands) - tolerance <= reported <= max(commands) + tolerance


MOVED_SHARE = 0.5
"""of its command that steering moves by at least, or the other way where it is reversed: play takes some of it, and one
an eighth as fast as the motor shows a quarter of a swerve"""


def moved_share(done: Array, asked: Array) -> float:
    """Least-squares share of the changes of `asked` that those of `done` are; arrays (n,); 0 where nothing is asked."""
    least_squares = asked.var()
    return float(np.mean((asked - asked.mean()) * (done - done.mean())) / least_squares) if least_squares else 0.0


class ReversedMonitor:
    """Steering that goes to the other side than its command: the sensor says so, and the car turns that way.

    Steering that is late or stuck does not go to the other side. A sensor with a wrong sign is contradicted by the
    gyro, which is not judged by it: it moves `against` its command.
    """

    def __init__(self, car: Car) -> None:
        self._of = SteeringReports(car)
        self._reported: deque[float] = deque(maxlen=self._of.window)
        self._asked: deque[float] = deque(maxlen=self._of.window)
        self.against = False
        """whether what is reported lies on the other side and moves to it as the command moves"""
        self.found = False
        """until the car stands, where a stop follows"""
        self._misreported = 0
        """for so many periods it is known that the report is reversed, as the car turned as it was asked to: what
        contradicts that later is a slide"""

    def step(  # noqa: PLR0917 - what it is judged by
        self, state: VehicleState, turns: SteeringHypotheses, speed: float, commanded: ActuatorPositions | None,
        steer_zero: float, keeps: bool,
    ) -> None:  # fmt: skip
        """By which angle the car `turns`; `commanded` stands on the wire, None while the car does not obey;
        `steer_zero` as learnt, rad at the road wheel; once a period. What is found `keeps` in a stop, and while the
        steering is off its command."""
        self.against, self.found = False, self.found and keeps and speed > 0.0
        self._misreported = max(self._misreported - (not keeps), 0) if speed > 0.0 else 0
        if commanded is None or not state.sources["steering"].valid:
            self._asked.clear()
            self._reported.clear()
            return
        steer, asked = state.steer + steer_zero, commanded.steering_motor
        self._asked.append(asked)
        self._reported.append(state.steer * self._of.ratio)  # without what is learnt, which would pass for a movement
        if asked * steer < 0.0 and speed > SLOWEST:
            self._judge(turns, steer * self._of.ratio, math.copysign(1.0, asked))

    def _judge(self, turns: SteeringHypotheses, motor: float, side: float) -> None:
        """A report on the other side than its command; `motor` with its zero, rad."""
        self.against = self._moves_against()
        if turns.as_asked:
            self._misreported = round(RENEWED_S / PERIOD_S)
        elif turns.as_reported and not self._misreported:
            self.found = self.found or self.against or self._mirrors(side, motor)

    def _mirrors(self, side: float, motor: float) -> bool:
        """Whether it has gone to where its command would be on the other side."""
        asked, apart = list(self._asked), self._of.apart
        newest = asked[-self._of.answer :]
        outside = not min(asked) - apart <= motor <= max(asked) + apart
        mirrored = min(newest) - apart < -motor < max(newest) + apart
        return outside and mirrored and side * (self._reported[0] - self._reported[-1]) > apart

    def _moves_against(self) -> bool:
        """Whether it goes to the other side as its command moves, however slowly and however late it may be, and
        neither stands there nor seems to move by the noise of its sensor."""
        if len(self._asked) < self._of.window:
            return False
        asked, reported, late, answer = np.array(self._asked), np.array(self._reported), self._of.late, self._of.answer
        due, later = asked[:-late], asked[:-answer]
        by_noise = GATE * self._of.still / math.sqrt(len(due))
        moves = (moved_share(reported[late:], due) + MOVED_SHARE) * due.std() < -by_noise
        return bool(moves) and moved_share(reported[answer:], later) < -MOVED_SHARE


class AccelerationMonitor:
    """Longitudinal specific force against the force commanded for a window: dead brakes, a stuck throttle, or an
    IMU that says nothing."""

    def __init__(self, car: Car) -> None:
        self._per_pa = car.powertrain.brake_force_per_pa / car.vehicle.mass
        self._pushed = sound_imu_within(car)[1]
        """m/s2 forward with the accelerator closed: specific force has no gravity in it, and drag is backward"""
        self._held = ConditionTime()

    def step(self, now_ns: int, ax: float, commands: Sequence[ActuatorPositions]) -> float:
        """Seconds the car has not done what all of these commands ask, none where nothing can tell."""
        pushed = len(commands) > 0 and ax > self._pushed and all(c.accelerator == 0.0 for c in commands)
        return self._held.update(pushed or (len(commands) > 0 and self._unbraked(ax, commands)), now_ns)

    def _unbraked(self, ax: float, commands: Sequence[ActuatorPositions]) -> bool:
        if not self._braking(commands[-1]) > BRAKED:
            return False  # as it nearly always is
        braking = min(map(self._braking, commands))
        return braking > BRAKED and ax > -BRAKED_SHARE * min(braking, 2 * BRAKED)

    def _braking(self, command: ActuatorPositions) -> float:
        """Deceleration that is commanded, m/s2."""
        return (command.brake_front + command.brake_rear) * self._per_pa
