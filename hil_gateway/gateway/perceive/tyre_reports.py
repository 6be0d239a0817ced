"""Tyre temperatures and pressures as the car reports them, and a tyre that has lost its air.

`tyre.*.pressure` counts from vacuum, `tyre.*.gauge` from the standard atmosphere.
"""

from __future__ import annotations

import math

from can_dbc.quantities import WHEELS
from can_dbc.units import ATMOSPHERE
from hil_gateway.bus.topics import TYRES
from hil_gateway.bus.tyres import Tyres
from hil_gateway.gateway.perceive.duration import ConditionTime
from hil_gateway.gateway.perceive.vehicle_state import VehicleStateBuilder

MOST_PA = 400_000.0
"""over the air outside; more is no race tyre's pressure"""
LOST = 0.5
"""share of the pressure it had, over the air outside, below which a tyre is flat: warming up moves it by a fifth. Less
than this share of the air itself reads only a sensor that is not there or dead, which says nothing of the tyre"""
RISE = 1e-3
"""share of a higher reading taken over in a period: 10 s, so that a wrong frame makes no tyre flat"""


class TyreReports:
    """The newest reports as a message, and how long a tyre has been flat."""

    def __init__(self, builder: VehicleStateBuilder) -> None:
        self._builder = builder
        self._inside, self._over = ([f"tyre.{wheel}.{kind}" for wheel in WHEELS] for kind in ("pressure", "gauge"))
        self._treads = {wheel: builder.reported(f"tyre.{wheel}.temperature.") for wheel in WHEELS}
        self._had: dict[str, float] = {}
        self._flat = ConditionTime()
        self._due_ns = self._seq = 0
        self.flat = self.flat_front = self.flat_rear = False
        """whether a tyre, of any or of one axle, was flat when it was last asked"""

    def flat_s(self, now_ns: int) -> float:
        """Seconds a tyre has had less than half of the pressure it had, infinite where both values of its report say
        so, which no wrong bit makes them; once a period."""
        flat = [self._is_flat(name) for name in self._inside]  # each keeps its own pressure
        sure = [self._has_lost(name, self._builder.value(name)) for name in self._over]
        self.flat_front, self.flat_rear = any(flat[:2]), any(flat[2:])
        self.flat = self.flat_front or self.flat_rear
        held_s = self._flat.update(self.flat, now_ns)
        return math.inf if any(map(all, zip(flat, sure, strict=True))) else held_s

    def message(self, now_ns: int) -> Tyres | None:
        """The message, when it is due."""
        if now_ns < self._due_ns:
            return None
        self._due_ns = now_ns + TYRES.period_ns
        self._seq += 1
        treads = [self._tread(wheel) for wheel in WHEELS]
        return Tyres(
            stamp_ns=now_ns,
            seq=self._seq - 1,
            temperature=tuple(sum(tread) / len(tread) if tread else None for tread in treads),
            hottest=tuple(max(tread, default=None) for tread in treads),
            pressure=tuple(self._builder.value(n) if self._builder.known(n) else None for n in self._over),
        )

    def _is_flat(self, name: str) -> bool:
        inside = self._builder.value(name)
        return inside >= LOST * ATMOSPHERE and self._has_lost(name, inside - ATMOSPHERE)

    def _has_lost(self, signal: str, over: float) -> bool:
        """Whether a pressure over the air outside, Pa, is less than half of what its signal had."""
        if over > MOST_PA:
            return False
        had = self._had.setdefault(signal, over)
        if over > had:
            self._had[signal] = had + RISE * (over - had)
        return over < LOST * had

    def _tread(self, wheel: str) -> list[float]:
        return [self._builder.value(name) for name in self._treads[wheel] if self._builder.known(name)]
