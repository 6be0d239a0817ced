"""What the road does to the car: gravity in body axes from grade, bank and vertical curvature along the track."""

from __future__ import annotations

import math

import numpy as np

from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.plant.parameters import RoadParameters
from hil_gateway.track.track import Track


class Road:
    """Track under the car; keeps the last projection as the hint of the next."""

    def __init__(self, track: Track, parameters: RoadParameters) -> None:
        self.track = track
        self._n = len(track.s)
        self._per_metre = self._n / track.length
        self._heading = track.heading.tolist()
        self._grade = (parameters.grade * track.grade).tolist()
        self._bank = (parameters.bank * track.bank).tolist()
        bend = np.gradient(np.concatenate([track.grade[-1:], track.grade, track.grade[:1]]), track.length / self._n)
        self._bend = (parameters.grade * bend[1:-1]).tolist()
        self.s = 0.0
        self.lateral = 0.0

    def locate(self, x: float, y: float) -> None:
        """Find the car on the track."""
        self.s, self.lateral = self.track.project(x, y, self.s)

    def gravity(self, yaw: float, vx: float, yaw_rate: float) -> tuple[float, float, float]:
        """Along x and y of the body and normal to the road, m/s2, at the place last located.

        Grade theta pulls by -g sin(theta) along the track, bank b by -g sin(b) to its left. Normal to the road act
        weight, the vertical curve (v^2 dtheta/ds: heavier in a dip) and the part of the centripetal acceleration that a
        banked road takes.
        """
        i = min(int(self.s * self._per_metre), self._n - 1)
        grade, bank = self._grade[i], self._bank[i]
        off = yaw - self._heading[i]
        along, left = -GRAVITY * math.sin(grade), -GRAVITY * math.sin(bank)
        cos, sin = math.cos(off), math.sin(off)
        normal = GRAVITY * math.cos(grade) * math.cos(bank) + vx * vx * self._bend[i] - vx * yaw_rate * math.sin(bank)
        return along * cos + left * sin, left * cos - along * sin, normal
