"""Actuators against their commands: reported positions, and the acceleration that follows from them."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from hil_gateway.bus.messages import VehicleState
from hil_gateway.car.actuation import ActuatorPositions
from hil_gateway.car.car import Actuators, Car
from hil_gateway.gateway.perceive.duration import ConditionTime
from hil_gateway.gateway.perceive.motion import ANSWER, BRAKED, periods_late
from hil_gateway.observer.bank import GATE, RENEWED_S
from hil_gateway.observer.numbers import sound_imu_within
from hil_gateway.observer.observer import SLOWEST
from hil_gateway.observer.steering import SteeringHypotheses
from hil_gateway.settings.gateway import PERIOD_S

PEDALS = 0.12
"""of the full accelerator, and of the full pressure of a brake: scatter of pads and lines"""
BRAKED_SHARE = 0.3
"""of what was commanded: cars with hot brakes, wet tyres and an unequal balance do better"""


class SteeringReports:
    """What reports of the steering may differ by: angles at the motor, rad; periods."""

    def __init__(self, car: Car) -> None:
        self.ratio, self.late = car.vehicle.steering_ratio, periods_late(car)
        self.still = car.sensors.steering_noise
        """noise of a sensor of steering that does not move"""
        self.apart = car.std("sensors.steering_offset") + (GATE + 1.0) * self.still
        """how far it may be off with the offset of its sensor, play and overshoot"""
        self.answer = ANSWER * self.late
        self.window = ANSWER * self.answer
        """of whose commands one has been reached"""


class Answer:
    """What an actuator makes of its commands: dead time, then first order."""

    def __init__(self, delay: float, bandwidth: float, asked: float) -> None:
        """s and Hz; the first command."""
        self._dead = deque([asked], maxlen=2 + round(delay / PERIOD_S))
        """and a period until it is reported"""
        self._follows = 1.0 - math.exp(-math.tau * bandwidth * PERIOD_S)
        self._now = asked

    def step(self, asked: float) -> float:
        """What is due in the period of this command."""
        self._dead.append(asked)
        self._now += self._follows * (self._dead[0] - self._now)
        return self._now


class BrakesDue:
    """Pressures that are due of both circuits, Pa: as they are asked for, of brakes as late as declared, and `ANSWER`
    times as late."""

    def __init__(self, acts: Actuators) -> None:
        self._acts, self._answers = acts, list[tuple[Answer, Answer]]()
        self.now: Sequence[tuple[float, float]] = ()

    def step(self, asked: tuple[float, float] | None) -> None:
        """Once a period; None where the car does not obey."""
        if asked is None:
            self._answers, self.now = [], ()
            return
        if not self._answers:
            delay, bandwidth = self._acts.brake_delay, self._acts.brake_bandwidth
            for slower in (1, ANSWER):
                front, rear = (Answer(slower * delay, bandwidth / slower, pressure) for pressure in asked)
                self._answers.append((front, rear))
        self.now = [asked, *((front.step(asked[0]), rear.step(asked[1])) for front, rear in self._answers)]

    @property
    def least(self) -> tuple[float, float]:
        """Of these; nothing where the car does not obey."""
        front, rear = zip(*self.now, strict=True) if self.now else ((0.0,), (0.0,))
        return min(front), min(rear)

    def holds(self, reported: tuple[float, float], tolerance: float) -> bool:
        """Whether what is reported lies between these."""
        ranges = zip(reported, *self.now, strict=True)
        return all(min(due) - tolerance <= pressure <= max(due) + tolerance for pressure, *due in ranges)


class FollowingMonitor:
    """Reported positions within what is due by their commands, and moving with them; reports that are invalid say
    nothing of actuators."""

    def __init__(self, car: Car) -> None:
        self._of, self._brakes = SteeringReports(car), BrakesDue(car.actuators)
        self._scatter = PEDALS * car.powertrain.brake_pressure_max
        self._commands: deque[ActuatorPositions] = deque(maxlen=self._of.window)
        self.obeyed: Sequence[ActuatorPositions] = ()
        """all commands of a window, which the car has had to obey"""
        self._steering, self._pedals = ConditionTime(), ConditionTime()

    def step(
        self, now_ns: int, state: VehicleState, commanded: ActuatorPositions | None, moves: bool, told: bool
    ) -> tuple[float, float]:
        """How long what steering and pedals report has been outside of their commands, or the steering no longer
        `moves` as its own do, s. `commanded` stands on the wire; None while nothing is sent or the car does not obey.
        Whether it is `told` that the car turns by its command and not by its report, or the reverse: then no offset
        excuses it."""
        if commanded is None:
            self._commands.clear()
        else:
            self._commands.append(commanded)
        self._brakes.step((commanded.brake_front, commanded.brake_rear) if commanded else None)
        full = len(self._commands) == self._of.window
        self.obeyed = self._commands if full else ()
        motor = state.steer * self._of.ratio
        steers = full and state.sources["steering"].valid
        apart = 0.0 if told else self._of.apart
        steers = steers and (not moves or self._outside(motor, "steering_motor", apart))
        pedals = full and state.sources["pedals"].valid
        pressures = state.brake_front, state.brake_rear
        pedals = pedals and (
            not self._brakes.holds(pressures, self._scatter) or self._outside(state.accelerator, "accelerator", PEDALS)
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


class Moved(NamedTuple):
    """Least-squares share of the changes that are due that steering has made; negative to the other side."""

    share: float
    unsure: float
    """by which chance may change it"""

    def within(self, low: float, high: float) -> bool:
        """Whether it is sure to be in between."""
        return low + self.unsure < self.share < high - self.unsure


class _Due:
    """Angles that are due from steering beside those that are reported, rad at the motor."""

    def __init__(self, acts: Actuators, slower: float, noise: float, asked: float) -> None:
        """Of steering so many times `slower` than declared; `noise` of a report; the first command."""
        self._answer = Answer(slower * acts.steering_delay, acts.steering_bandwidth / slower, asked)
        self._noise2, self._play2 = noise**2, (GATE * noise) ** 2 / 8.0
        """variance of a weave that play may swallow: less tells nothing"""
        self._sums = deque([(0.0,) * 5], maxlen=1 + round(RENEWED_S / PERIOD_S))
        """of both angles, of their squares and of their product, since the beginning"""

    def step(self, asked: float, reported: float) -> None:
        """A period."""
        x, y, (sx, sy, sxx, sxy, syy) = self._answer.step(asked), reported, self._sums[-1]
        self._sums.append((sx + x, sy + y, sxx + x * x, sxy + x * y, syy + y * y))

    def lately(self, periods: int) -> Iterator[int]:
        """So many periods, twice as many and so on, as far as it is known."""
        while periods < len(self._sums):
            yield periods
            periods *= 2

    def moved(self, periods: int) -> Moved:
        """In the last ones."""
        sums = zip(self._sums[-1], self._sums[-1 - periods], strict=True)
        x, y, xx, xy, yy = [(now - before) / periods for now, before in sums]
        due2, both = xx - x * x, xy - x * y
        if due2 <= self._play2:
            return Moved(0.0, math.inf)
        rest2 = max(yy - y * y - both**2 / due2, self._noise2)  # what the share leaves of the reports
        return Moved(both / due2, GATE * math.sqrt(rest2 / (periods * due2)))


class SteeringMonitor:
    """Steering that does not move as its command does: it stands, or goes to the other side; the sensor says so, and
    where it goes to the other side the car turns that way.

    Steering that is late or stuck does not go to the other side. A sensor with a wrong sign is contradicted by the
    gyro, which is not judged by it: it moves `against` its command.
    """

    def __init__(self, car: Car) -> None:
        self._of, self._acts = SteeringReports(car), car.actuators
        self._asked: deque[float] = deque(maxlen=self._of.window)
        self._reported: deque[float] = deque(maxlen=self._of.window)
        """without what is learnt of its zero, which would pass for a movement"""
        self._due: Sequence[_Due] = ()
        """as late as declared, and `ANSWER` times as late"""
        self.stands = self.against = False
        """whether what is reported does not move as the command does; or lies on the other side and moves to it"""
        self.found = False
        """until the car stands, where a stop follows"""
        self._misreported = 0
        """for so many periods it is known that the report is reversed, as the car turned as it was asked to: what
        contradicts that later is a slide"""

    @property
    def moves(self) -> bool:
        """Whether it moves as it is asked to, as far as can be told."""
        return not (self.stands or self.against)

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
            self.stands = False
            return
        steer, asked = state.steer + steer_zero, commanded.steering_motor
        self._asked.append(asked)
        self._reported.append(state.steer * self._of.ratio)
        if len(self._asked) == 1:
            self._due = [_Due(self._acts, slower, self._of.still, asked) for slower in (1.0, ANSWER)]
        for due in self._due:
            due.step(asked, self._reported[-1])
        self.stands = self._moved_within(-MOVED_SHARE, MOVED_SHARE)
        if asked * steer < 0.0 and speed > SLOWEST:
            self._judge(turns, steer * self._of.ratio, math.copysign(1.0, asked))

    def _judge(self, turns: SteeringHypotheses, motor: float, side: float) -> None:
        """A report on the other side than its command; `motor` with its zero, rad."""
        self.against = self._moved_within(-math.inf, -MOVED_SHARE)
        if turns.as_asked:
            self._misreported = round(RENEWED_S / PERIOD_S)
        elif turns.as_reported and not self._misreported:
            self.found = self.found or self.against or self._mirrors(side, motor)

    def _mirrors(self, side: float, motor: float) -> bool:
        """Whether it has gone to where its command would be on the other side."""
        asked, apart = self._asked, self._of.apart
        newest = list(asked)[-self._of.answer :]
        outside = not min(asked) - apart <= motor <= max(asked) + apart
        mirrored = min(newest) - apart < -motor < max(newest) + apart
        return outside and mirrored and side * (self._reported[0] - self._reported[-1]) > apart

    def _moved_within(self, low: float, high: float) -> bool:
        """Whether the share of its command's changes that it has made in any time is sure to be in between, and a later
        answer does not explain that."""
        now, later = self._due
        times = [n for n in now.lately(self._of.answer) if now.moved(n).within(low, high)]
        return any(low < later.moved(n).share < high for n in times)


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
