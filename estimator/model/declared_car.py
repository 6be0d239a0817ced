"""What is declared of the race car beyond Eq. (1)-(3), as effects: air, load transfer, brakes, steering zero.

Nominal values come from the data sheet (`hil_gateway.car`), never from a car that was driven. How well they are known
is stated beside them, and the belief goes on from there while driving.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from estimator.model.effect import DeclaredParameter, Effect
from estimator.model.effects import catalogue
from estimator.model.parameters import LAYOUTS, Layout
from estimator.model.single_track import Stage
from hil_gateway.car.car import Car
from hil_gateway.process.arrays import Array


def declared_effects(car: Car) -> dict[str, dict[str, DeclaredParameter]]:
    """Effects of the race car with nominal values: effect -> parameter -> value and how well it is known."""
    declared = sorted((e for e in catalogue().values() if e.declare), key=_order)
    return {e.name: dict(zip((p.name for p in e.parameters), _declared(e, car), strict=True)) for e in declared}


def _order(effect: Effect) -> tuple[int, int, str]:
    """What shows in fewest channels first, then as the physics acts: belief and id of a model keep to one order."""
    return len(effect.channels), max(Stage[stage].value for stage in effect.hooks), effect.name


def _declared(effect: Effect, car: Car) -> tuple[DeclaredParameter, ...]:
    """Of the parameters of an effect; the deviation of a ratio to a tyre parameter has that one's too."""
    assert effect.declare is not None
    return tuple(
        replace(p, std=float(np.hypot(p.std, p.value * _relative_std(car, p.over)))) if p.over else p
        for p in effect.declare(car)
    )


def declared_tyre_std(car: Car, layout: Layout) -> dict[str, float]:
    """Standard deviation of every declared tyre parameter of a car, SI."""
    return {name: car.std(f"tyres.{name}") for name in LAYOUTS[layout]}


def _relative_std(car: Car, name: str) -> float:
    """Of a declared tyre parameter."""
    return car.relative_std(f"tyres.{name}")


def declared_covariance(car: Car, layout: Layout) -> Array:
    """Of the tyre parameters of a race car and those of its declared effects after them (n, n), SI."""
    tyres = declared_tyre_std(car, layout)
    known = [p for named in declared_effects(car).values() for p in named.values()]
    covariance = np.diag(np.array([*tyres.values(), *(p.std for p in known)]) ** 2)
    for row, p in enumerate(known, len(tyres)):
        if p.over:
            column = [*tyres].index(p.over)
            covariance[row, column] = covariance[column, row] = -p.value * _relative_std(car, p.over) * tyres[p.over]
    return covariance
