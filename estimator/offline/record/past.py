"""What effects with memory make of the past of a record: of the whole of it, however few windows are fitted.

A fit asks for the same past again and again: for its derivatives by each parameter, at the start of every other
candidate, and for effects that it changes one of several of.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from estimator.model.effect import Effect
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.process.arrays import Array

KEPT = 32
"""Sets of parameters whose signals are kept: a fit has a few, a quarter of an hour at 100 Hz takes 1.6 MB for one."""
Numbered = tuple[Effect, tuple[float, ...]]
"""an effect with its parameters"""


class Past:
    """The past of one record, by the parameters that were asked for last."""

    def __init__(self, signals: Mapping[str, Array], vehicle: Vehicle, thin: Callable[[Array], Array]) -> None:
        """`thin` makes block means of a signal (n,)."""
        self._signals, self._vehicle, self._thin = signals, vehicle, thin
        self._made: dict[tuple[tuple[str, tuple[float, ...]], ...], Mapping[str, tuple[Array, Array]]] = {}

    def __call__(self, effects: Sequence[Numbered], names: Sequence[str]) -> Array:
        """(m * windows * blocks,) block means of the signals `names` (m,) that the effects make one after the other."""
        made: Mapping[str, tuple[Array, Array]] = {}
        for count in range(1, len(effects) + 1):
            made = self._after(effects[:count], made)
        return np.concatenate([np.zeros(0), *(made[name][1] for name in names)])

    def _after(
        self, effects: Sequence[Numbered], before: Mapping[str, tuple[Array, Array]]
    ) -> Mapping[str, tuple[Array, Array]]:
        """Signals and their block means after the last of `effects`, from those `before` it."""
        key = tuple((effect.name, parameters) for effect, parameters in effects)
        if key not in self._made:
            effect, parameters = effects[-1]
            assert effect.prepare is not None
            signals = {**self._signals, **{name: whole for name, (whole, _) in before.items()}}
            new = effect.prepare(signals, self._vehicle, parameters)
            while len(self._made) >= KEPT:
                del self._made[next(iter(self._made))]
            self._made[key] = {**before, **{name: (whole, self._thin(whole).ravel()) for name, whole in new.items()}}
        else:
            self._made[key] = self._made.pop(key)  # asked for last
        return self._made[key]
