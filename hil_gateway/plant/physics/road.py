"""What the road does to the car: gravity in body axes from grade, bank and vertical curvature along the track."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.plant.physics.parameters import RoadParameters
from hil_gateway.track.track import Track


class Slopes(NamedTuple):
    """Of the road at one place (numbers) or several (arrays): grade and bank, rad, and the grade's slope, rad/m."""

    grade: Any
    bank: Any
    bend: Any


def slopes_of(track: Track, parameters: RoadParameters) -> Slopes:
    """Slopes at the points of a track, shape (n,) each."""
    bend = np.gradient(np.concatenate([track.grade[-1:], track.grade, track.grade[:1]]), track.length / len(track.s))
    grade, bank = parameters.grade * track.grade, parameters.bank * track.bank
    return Slopes(grade, bank, parameters.grade * bend[1:-1])


def body_gravity(slopes: Slopes, off: Any, vx: Any, yaw_rate: Any, functions: Any) -> tuple[Any, Any, Any]:
    """Along x and y of the body and normal to the road, m/s2; `off` is the yaw against the track, rad.

    Grade theta pulls by -g sin(theta) along the track, bank b by -g sin(b) to its left. Normal to the road act
    weight, the vertical curve (v^2 dtheta/ds: heavier in a dip) and the part of the centripetal acceleration that a
    banked road takes. `functions` has sin and cos: `math` for numbers, `numpy` for arrays.
    """
    sin, cos = functions.sin, functions.cos
    along, left = -GRAVITY * sin(slopes.grade), -GRAVITY * sin(slopes.bank)
    normal = GRAVITY * cos(slopes.grade) * cos(slopes.bank) + vx * vx * slopes.bend - vx * yaw_rate * sin(slopes.bank)
    return along * cos(off) + left * sin(off), left * cos(off) - along * sin(off), normal


class Road:
    """Track under the car; keeps the last projection as the hint of the next."""

    def __init__(self, track: Track, parameters: RoadParameters) -> None:
        self.track = track
        self._n = len(track.s)
        self._per_metre = self._n / track.length
        self._heading = track.heading.tolist()
        self._grade, self._bank, self._bend = (values.tolist() for values in slopes_of(track, parameters))
        self.s = 0.0
        self.lateral = 0.0

    def locate(self, x: float, y: float) -> None:
        """Find the car on the track."""
        self.s, self.lateral = self.track.project(x, y, self.s)

    def gravity(self, yaw: float, vx: float, yaw_rate: float) -> tuple[float, float, float]:
        """`body_gravity` at the place last located."""
        i = min(int(self.s * self._per_metre), self._n - 1)
        slopes = Slopes(self._grade[i], self._bank[i], self._bend[i])
        return body_gravity(slopes, yaw - self._heading[i], vx, yaw_rate, math)
