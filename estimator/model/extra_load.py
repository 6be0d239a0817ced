"""The load that crests, dips and banks add to the axles, from what the car's IMU reports."""

from __future__ import annotations

import numpy as np

from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.process.arrays import Array

LOAD_SEEN = (-0.7, 2.0)
"""what crests, dips and banks can add to the axle loads, over the weight: on 20 degrees at 75 m/s it is 0.8"""


def extra_load(az: float) -> float:
    """Share by which the road presses on the car more than its weight, from the vertical specific force (m/s2).

    A sensor that says what no road does (`LOAD_SEEN`) is not believed: a level road is assumed.
    """
    extra = az / GRAVITY - 1.0
    return extra if LOAD_SEEN[0] < extra < LOAD_SEEN[1] else 0.0


def extra_loads(az: Array) -> Array:
    """The same for (n,) samples."""
    return np.array([extra_load(value) for value in az.tolist()])
