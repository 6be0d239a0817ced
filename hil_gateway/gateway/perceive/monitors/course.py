"""The IMU and the wheels against the course of the position fixes, which knows neither tyres nor wheels.

Where IMU and course contradict each other, the rear wheels' difference and the steering decide: the one that their
mean lies nearer to is used. Alone, the difference is 0.15 rad/s wrong after a long bend: one outer wheel has slipped
more, and that was learnt as a larger radius.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

from hil_gateway.gateway.perceive.course import COURSE_WINDOW, Course
from hil_gateway.gateway.perceive.duration import ConditionTime
from hil_gateway.gateway.perceive.gyro_repair import APART

LATERAL = 7.0
"""m/s2: side slip that builds up, lag of the course"""
SPEED_SHARE = 0.14
"""of the course's speed: slip of all wheels, unequal rolling radii, lag of the course"""

OUTVOTED = 0.12
"""rad/s between gyro and course from which steering and wheels are asked who is right: four deviations of the course"""


class Contradicted(NamedTuple):
    """How long, s."""

    yaw_rate: float
    acceleration: float
    wheels: float
    position: float
    """the course contradicts the IMU, and wheels and steering agree with the IMU"""


class SteadyCourse:
    """A course that fixes have had for a whole window: fixes that scatter lie on one curve by chance now and then."""

    def __init__(self) -> None:
        self._periods = 0

    def step(self, course: Course | None) -> Course | None:
        """`course`, once there was one in every period of a window."""
        self._periods = 0 if course is None else self._periods + 1
        return course if self._periods >= COURSE_WINDOW else None


class CourseMonitor:
    """Means of gyro and lateral specific force, and the speed of the wheels, against turn rate and speed."""

    def __init__(self) -> None:
        self._yaw_rates: deque[float] = deque(maxlen=COURSE_WINDOW)
        self._forces: deque[float] = deque(maxlen=COURSE_WINDOW)
        self._others: deque[float] = deque(maxlen=COURSE_WINDOW)
        self._yaw_rate, self._acceleration, self._wheels, self._position = (ConditionTime() for _ in range(4))
        self.shares: dict[str, float] = {}
        """each difference over its bound in this period"""

    def step(
        self,
        now_ns: int,
        imu: tuple[float, float],
        wheel_speed: float,
        others: tuple[float, float],
        course: Course | None,
    ) -> Contradicted:
        """`imu`: yaw rate (rad/s) and lateral specific force without gravity (m/s2). `others`: yaw rates that the
        rear wheels' difference and the steering mean, rad/s. `course` is None where the fixes say nothing, or are not
        believed."""
        self._yaw_rates.append(imu[0])
        self._forces.append(imu[1])
        self._others.append(sum(others) / len(others))
        if course is None or len(self._forces) < COURSE_WINDOW:
            self.shares = {}
            return self._contradicted(now_ns, False)
        gyro, force, mean = (sum(kept) / COURSE_WINDOW for kept in (self._yaw_rates, self._forces, self._others))
        turn, speed = course.turn_rate, course.speed
        self.shares = {
            "turn": abs(gyro - turn) / course.turn_within(APART),
            "lateral": abs(force - speed * turn) / LATERAL,
            "speed": abs(wheel_speed - speed) / (SPEED_SHARE * speed),
        }
        with_imu = {"turn": abs(mean - gyro), "lateral": abs(mean - force / speed)}
        return self._contradicted(now_ns, all(with_imu[name] < abs(mean - turn) for name in self._over(*with_imu)))

    def _over(self, *names: str) -> list[str]:
        return [name for name in names if self.shares.get(name, 0.0) > 1.0]

    def _contradicted(self, now_ns: int, sides_with_imu: bool) -> Contradicted:
        imu = not sides_with_imu
        return Contradicted(
            self._yaw_rate.update(imu and bool(self._over("turn")), now_ns),
            self._acceleration.update(imu and bool(self._over("lateral")), now_ns),
            self._wheels.update(bool(self._over("speed")), now_ns),
            self._position.update(sides_with_imu and bool(self._over("turn", "lateral")), now_ns),
        )


class TurnWitness:
    """Whether steering and wheels both side with the course of the fixes, and not with the gyro.

    A fix beside the way that gyro and wheels have reckoned says that one of them is wrong, not which: a step, a ramp or
    a delay of positions has no steering and no wheels with it. The first clear answer counts until the fixes fit
    again: under the brakes of the stop that follows, wheels and steering say little of how the car turns.
    """

    def __init__(self) -> None:
        self._kept: deque[tuple[float, float, float]] = deque(maxlen=COURSE_WINDOW)
        self._with_gyro = False

    def step(self, rates: tuple[float, float, float], course: Course | None, suspect: bool) -> bool:
        """Yaw rates by gyro, wheels and steering in one period, rad/s; the course of fixes that are `suspect`, None
        where it is not known or the wheels say nothing."""
        self._kept.append(rates)
        self._with_gyro = self._with_gyro and suspect
        if course is None or not suspect:
            return False
        gyro, *others = (sum(kept) / len(self._kept) for kept in zip(*self._kept, strict=True))
        turn = course.turn_rate
        apart, with_course = abs(gyro - turn) > OUTVOTED, [abs(by - turn) < abs(by - gyro) for by in others]
        self._with_gyro = self._with_gyro or (apart and not any(with_course))
        return apart and all(with_course) and not self._with_gyro
