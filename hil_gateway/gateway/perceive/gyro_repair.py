"""A gyro that went wrong in a known way: by an offset, or by its sign; with it taken back the yaw rate is right again.

A stop without a gyro goes by the course of the fixes, which a car that begins to spin leaves late, and by the wheels,
which slip under the brakes. What the way a gyro failed in tells of the yaw rate is better than either.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from hil_gateway.gateway.perceive.course import COURSE_WINDOW, Course

APART = 0.32
"""rad/s from the turn rate of the fixes' course: side slip that builds up, lag of the course"""


@dataclass(frozen=True, slots=True)
class GyroRepair:
    """yaw rate = sign (reading - offset)."""

    sign: float = 1.0
    offset: float = 0.0
    """rad/s"""
    force: float = 1.0
    """sign of the lateral specific force, 0 where it tells nothing"""

    def yaw_rate(self, reading: float) -> float:
        """rad/s."""
        return self.sign * (reading - self.offset)


class RepairedGyro:
    """Yaw rates of a gyro that has a repair, unless the fixes contradict its first ones.

    Later they may: the yaw rate of a car that begins to spin is not the turn rate of its course.
    """

    def __init__(self) -> None:
        self._rates: deque[float] = deque(maxlen=COURSE_WINDOW)
        self._refuted = False

    def step(self, repair: GyroRepair | None, reading: float | None, course: Course | None) -> float | None:
        """Yaw rate of a period, rad/s, None where there is none to go by. `reading` is None where nothing arrives,
        `course` that of the fixes, None where they say nothing."""
        if repair is None or reading is None:
            self._rates.clear()
            self._refuted = self._refuted and repair is not None
            return None
        rate = repair.yaw_rate(reading)
        if len(self._rates) < COURSE_WINDOW:
            self._rates.append(rate)
            if course is not None and len(self._rates) == COURSE_WINDOW:
                off = abs(sum(self._rates) / COURSE_WINDOW - course.turn_rate)
                self._refuted = off > course.turn_within(APART)
        return None if self._refuted else rate
