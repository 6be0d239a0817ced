"""Wheels that the brakes may have locked: what they show is no speed of the car, and no fault of a sensor."""

from __future__ import annotations

from collections import deque

from hil_gateway.config import Config
from hil_gateway.settings.gateway import PERIOD_S

LASTS_S = 0.5
"""after which a wheel that was locked rolls again"""
INNER = 0.5
"""of the braking that takes all of the declared grip, from which an inner wheel may lock: at the limit of a bend it
carries less than half of what the outer one does, and is braked as hard"""


class Braked:
    """The hardest braking lately, over what takes all of the tyres' declared grip."""

    def __init__(self, config: Config) -> None:
        self._stop, self._vehicle = config.gateway.stop, config.vehicle
        self._lately: deque[float] = deque(maxlen=round(LASTS_S / PERIOD_S))

    def step(self, braking: float, speed: float) -> float:
        """`braking` by the pressures that are reported, m/s2; `speed`, m/s; once a period."""
        self._lately.append(braking / self._stop.grip(self._vehicle, speed))
        return max(self._lately)
