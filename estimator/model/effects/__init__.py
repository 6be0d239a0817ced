"""Catalogue of effects the declared model lacks: one small file each, found by importing this package."""

from __future__ import annotations

import importlib
import pkgutil
from functools import cache

from estimator.model.effect import Effect
from estimator.model.parameters import Quantity


@cache
def catalogue() -> dict[str, Effect]:
    """All effects by id; each module of this package defines one as `EFFECT`."""
    names = sorted(m.name for m in pkgutil.iter_modules(__path__))
    effects = (importlib.import_module(f"{__name__}.{name}").EFFECT for name in names)
    return {effect.name: effect for effect in effects}


@cache
def effect_with(quantity: Quantity) -> Effect:
    """The effect of the catalogue with a parameter that is this quantity."""
    return next(effect for effect in catalogue().values() if effect.row_of(quantity) is not None)
