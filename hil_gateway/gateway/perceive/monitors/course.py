"""The IMU and the wheels against the course of the position fixes, which knows neither tyres nor wheels."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from hil_gateway.bus.messages import VehicleState
from hil_gateway.gateway.perceive.course import Course
from hil_gateway.gateway.perceive.monitors.held import Held
from hil_gateway.gateway.perceive.motion import COURSE_WINDOW

TURN = 0.32
"""rad/s: side slip that builds up, lag of the course, noise of both"""
LATERAL = 11.0
"""m/s2: gravity on the steepest bank (24 deg: 4.0), side slip that builds up, lag of the course"""
SPEED_SHARE = 0.14
"""of the course's speed: slip of all wheels, unequal rolling radii, lag of the course"""


@dataclass(frozen=True, slots=True)
class Contradicted:
    """How long, s."""

    yaw_rate: float
    acceleration: float
    wheels: float


class CourseMonitor:
    """Means of gyro and lateral specific force, and the speed of the wheels, against turn rate and speed."""

    def __init__(self) -> None:
        self._yaw_rates: deque[float] = deque(maxlen=COURSE_WINDOW)
        self._forces: deque[float] = deque(maxlen=COURSE_WINDOW)
        self._yaw_rate, self._acceleration, self._wheels = Held(), Held(), Held()
        self.shares: dict[str, float] = {}
        """each difference over its bound in this period"""

    def step(self, now_ns: int, state: VehicleState, wheel_speed: float, course: Course | None) -> Contradicted:
        """`course` is None where the fixes say nothing, or are not believed."""
        self._yaw_rates.append(state.yaw_rate)
        self._forces.append(state.ay)
        self.shares = {} if course is None or len(self._forces) < COURSE_WINDOW else self._compared(wheel_speed, course)
        return Contradicted(*(
            held.update(self.shares.get(name, 0.0) > 1.0, now_ns)
            for name, held in (("turn", self._yaw_rate), ("lateral", self._acceleration), ("speed", self._wheels))
        ))  # fmt: skip

    def _compared(self, wheel_speed: float, course: Course) -> dict[str, float]:
        yaw_rate, force = sum(self._yaw_rates) / COURSE_WINDOW, sum(self._forces) / COURSE_WINDOW
        return {
            "turn": abs(yaw_rate - course.turn_rate) / TURN,
            "lateral": abs(force - course.speed * course.turn_rate) / LATERAL,
            "speed": abs(wheel_speed - course.speed) / (SPEED_SHARE * course.speed),
        }
