"""Actuators against their commands: reported positions, and the acceleration that follows from them."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from hil_gateway.bus.messages import VehicleState
from hil_gateway.car.actuation import ActuatorPositions
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.gateway.perceive.monitors.duration import ConditionTime
from hil_gateway.gateway.perceive.motion import LATE
from hil_gateway.process.arrays import Array

WINDOW = 40
"""commands (0.4 s) among which the position must lie: delay (40 ms) and five time constants of the slowest actuator"""
STEERING = 0.14
"""rad at the motor (8 deg; 0.5 deg at the wheels): play, offset and noise of the sensor, overshoot"""
STILL = 0.009
"""rad at the motor (0.5 deg) within which a steering sensor stays that does not move"""
ASKED = 0.05
"""rad at the motor (3 deg) of change in its command after which steering that works has moved, whatever its offset"""
ANSWER = 20
"""periods (0.2 s) within which steering need not have answered yet: twice its delay, lag and the way of its report"""
ACCELERATOR = 0.12
BRAKES = 0.7e6
"""Pa: 12 % of full pressure, the scatter of pads and lines"""
JUDGED_FROM = 10.0
"""m/s: slower, engine braking, clutch and creep are as large as what is judged"""
BRAKING = 5.0
"""m/s2 of commanded braking from which the car must slow down"""
BRAKED_SHARE = 0.3
"""of what was commanded: cars with hot brakes, wet tyres and an unequal balance do better"""
PUSHED = 1.2
"""m/s2 forward with the accelerator closed: specific force has no gravity in it, so only drag and the IMU's bias (0.3)
are left, and drag is backward"""


@dataclass(frozen=True, slots=True)
class Follows:
    """How long what each actuator reports has been outside of its commands, s."""

    steering: float
    pedals: float


class _StandingSteering:
    """Steering that has not moved since some moment, although its commands from then on asked it to."""

    def __init__(self) -> None:
        self._low = self._high = math.nan
        self._unanswered: deque[float] = deque()
        self._least, self._most = math.inf, -math.inf
        """of the commands since then that had time to be answered"""

    def step(self, reported: float, asked: float) -> None:
        """Angles at the motor, rad; once a period."""
        self._low, self._high = min(self._low, reported), max(self._high, reported)
        if not self._high - self._low <= STILL:
            self._low = self._high = reported
            self._unanswered.clear()
            self._least, self._most = math.inf, -math.inf
        self._unanswered.append(asked)
        if len(self._unanswered) > ANSWER:
            answered = self._unanswered.popleft()
            self._least, self._most = min(self._least, answered), max(self._most, answered)

    @property
    def found(self) -> bool:
        """Whether it stands still against its commands."""
        return self._most - self._least > ASKED


class FollowingMonitor:
    """Reported positions within the commands of the last 0.4 s; reports that are invalid say nothing of actuators."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._ratio = vehicle.steering_ratio
        self._commands: deque[ActuatorPositions] = deque(maxlen=WINDOW)
        self._standing = _StandingSteering()
        self._steering, self._pedals = ConditionTime(), ConditionTime()

    def step(self, now_ns: int, state: VehicleState, commanded: ActuatorPositions | None) -> Follows:
        """`commanded` is what stands on the wire; None while nothing is sent or the car does not obey."""
        if commanded is None:
            self._commands.clear()
            self._standing = _StandingSteering()
        else:
            self._commands.append(commanded)
            self._standing.step(state.steer * self._ratio, commanded.steering_motor)
        full = len(self._commands) == WINDOW
        motor = state.steer * self._ratio
        steers = full and state.sources["steering"].valid
        steers = steers and (self._outside(motor, "steering_motor", STEERING) or self._standing.found)
        pedals = full and state.sources["pedals"].valid
        pedals = pedals and (
            self._outside(state.brake_front, "brake_front", BRAKES)
            or self._outside(state.brake_rear, "brake_rear", BRAKES)
            or self._outside(state.accelerator, "accelerator", ACCELERATOR)
        )
        return Follows(self._steering.update(steers, now_ns), self._pedals.update(pedals, now_ns))

    def _outside(self, reported: float, actuator: str, tolerance: float) -> bool:
        newest: float = getattr(self._commands[-1], actuator)
        if newest - tolerance <= reported <= newest + tolerance:
            return False  # as it nearly always is: the others can only widen the range
        commands = [getattr(command, actuator) for command in self._commands]
        return not min(commands) - tolerance <= reported <= max(commands) + tolerance


TURNS = 0.3
"""of v tan(delta) / L: the yaw rate of heavy understeer at top speed"""
AGAINST = -0.5
"""share of its command by which steering moves that is reversed, or less: play takes some of -1"""


def moved_share(done: Array, asked: Array) -> float:
    """Least-squares share of the changes of `asked` that those of `done` are; arrays (n,); 0 where nothing is asked."""
    least_squares = asked.var()
    return float(np.mean((asked - asked.mean()) * (done - done.mean())) / least_squares) if least_squares else 0.0


class ReversedMonitor:
    """Steering that goes to the other side than its command: the sensor says so, and the car turns that way.

    Steering that is late or stuck never moves away from its command, and a sensor with a wrong sign is contradicted
    by the gyro.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self._reported: deque[float] = deque(maxlen=WINDOW)
        self._asked: deque[float] = deque(maxlen=WINDOW)
        self.found = False
        """until the car stands"""

    def step(self, state: VehicleState, speed: float, commanded: ActuatorPositions | None) -> None:
        """`commanded` stands on the wire, None while the car does not obey; once a period."""
        self.found = self.found and speed > 0.0
        if commanded is None:
            self._asked.clear()
            self._reported.clear()
            return
        motor = state.steer * self._vehicle.steering_ratio
        self._asked.append(commanded.steering_motor)
        self._reported.append(motor)
        side = 1.0 if commanded.steering_motor > 0.0 else -1.0
        if side * motor < 0.0 and speed > JUDGED_FROM and state.sources["imu"].valid:
            asked = list(self._asked)
            outside = not min(asked) - STEERING <= motor <= max(asked) + STEERING
            mirrored = min(asked[-ANSWER:]) - STEERING < -motor < max(asked[-ANSWER:]) + STEERING
            turns = -side * state.yaw_rate > TURNS * speed * abs(math.tan(state.steer)) / self._vehicle.wheelbase
            went = side * (self._reported[0] - motor) > STEERING
            self.found = self.found or (outside and mirrored and turns and (went or self._moves_against()))

    def _moves_against(self) -> bool:
        """Whether it goes to the other side as its command moves, however slowly, and does not only stand there."""
        asked, reported = np.array(self._asked)[:-LATE], np.array(self._reported)[LATE:]
        return len(asked) == WINDOW - LATE and asked.std() > STILL and moved_share(reported, asked) < AGAINST


class AccelerationMonitor:
    """Longitudinal specific force against the force commanded for the last 0.4 s: dead brakes, a stuck throttle, or an
    IMU that says nothing."""

    def __init__(self, vehicle: Vehicle, brake_force_per_pa: float) -> None:
        self._per_pa = brake_force_per_pa / vehicle.mass
        self._commands: deque[ActuatorPositions] = deque(maxlen=WINDOW)
        self._held = ConditionTime()

    def step(self, now_ns: int, state: VehicleState, speed: float, commanded: ActuatorPositions | None) -> float:
        """Seconds the car has not done what all of these commands ask."""
        if commanded is None or speed < JUDGED_FROM:
            self._commands.clear()
            return self._held.update(False, now_ns)
        self._commands.append(commanded)
        if len(self._commands) < WINDOW:
            return self._held.update(False, now_ns)
        pushed = state.ax > PUSHED and all(c.accelerator == 0.0 for c in self._commands)
        return self._held.update(pushed or self._unbraked(state.ax), now_ns)

    def _unbraked(self, ax: float) -> bool:
        if not self._braking(self._commands[-1]) > BRAKING:
            return False
        braking = min(map(self._braking, self._commands))
        return braking > BRAKING and ax > -BRAKED_SHARE * min(braking, 2 * BRAKING)

    def _braking(self, command: ActuatorPositions) -> float:
        """Deceleration that is commanded, m/s2."""
        return (command.brake_front + command.brake_rear) * self._per_pa
