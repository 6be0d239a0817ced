"""The referee: laps, track limits, distance and speed, from the plant's own state. Nobody drives by it."""

from __future__ import annotations

import math

from hil_gateway.bus.interface import Bus
from hil_gateway.bus.messages import Truth
from hil_gateway.bus.topics import TRUTH

STANDSTILL_MPS = 0.3


class DriveReferee:
    """Watches the truth topic."""

    def __init__(self, bus: Bus) -> None:
        self._subscription = bus.subscribe(TRUTH, depth=64)
        self.truth: Truth | None = None
        self.distance_m = 0.0
        self.peak_speed = 0.0

    def update(self, now_ns: int) -> None:
        """Take in what has arrived."""
        for truth in self._subscription.poll(now_ns):
            if self.truth is not None:
                self.distance_m += math.hypot(truth.x - self.truth.x, truth.y - self.truth.y)
            self.truth = truth
            self.peak_speed = max(self.peak_speed, truth.vx)

    @property
    def laps(self) -> int:
        """Laps completed."""
        return len(self.lap_times_s)

    @property
    def lap_times_s(self) -> tuple[float, ...]:
        """Times of the completed laps, s."""
        return self.truth.lap_times_s if self.truth else ()

    @property
    def off_track(self) -> int:
        """Times the car left the track."""
        return self.truth.off_track_count if self.truth else 0

    @property
    def spins(self) -> int:
        """Times the car turned around."""
        return self.truth.spins if self.truth else 0

    @property
    def friction_over_s(self) -> float:
        """Longest time on end with an axle beyond the peak of its tyres, s."""
        return self.truth.friction_over_s if self.truth else 0.0

    @property
    def friction_used(self) -> tuple[float, float]:
        """Most of what the front and the rear axle could give that was used."""
        return self.truth.friction_used if self.truth else (0.0, 0.0)

    @property
    def speed(self) -> float:
        """m/s; 0 before the first message."""
        return self.truth.vx if self.truth else 0.0

    @property
    def standing(self) -> bool:
        """Whether the car stands still."""
        return abs(self.speed) < STANDSTILL_MPS
