"""How late the frames of a bus are that was silent and goes on where it stopped: they waited somewhere.

The counter of a message is the clock of its sender. Frames that were lost leave a gap in it; frames that waited do not,
and are late by what the clock is behind since the silence began. What they say is right, of a moment ago. A silence in
which the reader was held up itself is none: it has read since then whatever waited for it.
"""

from __future__ import annotations

from hil_gateway.gateway.perceive.dead_reckoning import Pose
from hil_gateway.gateway.perceive.duration import JITTER_S, SILENT_S
from hil_gateway.gateway.perceive.motion import Motion
from hil_gateway.gateway.perceive.vehicle_state import VehicleStateBuilder
from hil_gateway.process.clock import NS_PER_S


class Lateness:
    """Once a period; nothing is late before the first silence."""

    def __init__(self, builder: VehicleStateBuilder) -> None:
        self._builder, self._clock = builder, builder.clock
        layout = self._clock.layout if self._clock is not None else None
        self._period_ns = round(layout.period_s * NS_PER_S) if layout is not None else 0
        self._modulus = layout.counter.modulus if layout is not None and layout.counter is not None else 1
        self._newest_ns = self._heard_ns = self._since_ns = 0
        """stamp of the newest frames; since when nothing more would be a silence; when the one began after which the
        clock is read"""
        self._read_ns = 0
        self._count: int | None = None
        self._advanced = 0
        """frames of the clock since then"""
        self.late_ns = 0
        self.pauses = False
        """whether no frame has come since the period before"""

    def step(self, now_ns: int) -> int:
        """How late the newest frames are, ns; 0: in time."""
        newest_ns, count = self._builder.newest_ns, self._clock.counter if self._clock is not None else None
        held_up, self._read_ns = now_ns - self._read_ns > SILENT_S * NS_PER_S, now_ns
        silent = not held_up and newest_ns - self._heard_ns > SILENT_S * NS_PER_S
        self.pauses = newest_ns == self._newest_ns
        if held_up:
            self.forget()
        elif silent and not self._since_ns and self._count is not None:
            self._since_ns, self._advanced = self._heard_ns, 0
        if self._since_ns and count != self._count and count is not None and self._count is not None:
            self._advanced += (count - self._count) % self._modulus
            self.late_ns = newest_ns - self._since_ns - self._advanced * self._period_ns
            if self.late_ns < JITTER_S * NS_PER_S:
                self.forget()
        self._heard_ns = now_ns if held_up else self._heard_ns if self.pauses else newest_ns
        self._newest_ns, self._count = newest_ns, count
        return self.late_ns

    def forget(self) -> None:
        """Until the next silence: clocks differ, and in a long time add up to a lateness that is none."""
        self._since_ns = self.late_ns = 0


def brought_up(
    motion: Motion, pose: Pose | None, ax: float, turned: float, late_s: float
) -> tuple[Motion, Pose | None]:
    """Motion and pose of now from those of `late_s` ago, since when the car goes on with `ax` (m/s2) along it and its
    yaw rate has changed by `turned` (rad/s)."""
    speed, middle_rate = max(motion.speed + ax * late_s, 0.0), motion.yaw_rate + 0.5 * turned
    now = motion._replace(speed=speed, yaw_rate=motion.yaw_rate + turned, late_s=motion.late_s + late_s)
    if pose is None:
        return now, None
    return now, pose.onward(0.5 * (motion.speed + speed) * late_s, middle_rate * late_s)._replace(speed=speed)
