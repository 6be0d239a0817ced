"""The model in force as the start of a diagnosis: its effects are always fitted, around what is known of them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from estimator.model.effect import Effect
from estimator.model.effects import catalogue
from hil_gateway.bus.messages import ActiveEffect, ModelRevision


def parameter_std(revision: ModelRevision) -> dict[str, float]:
    """Standard deviation, SI, of what a revision's covariance covers: tyre parameters, then `effect.parameter`."""
    names = [*revision.tyre, *(f"{e.name}.{key}" for e in revision.effects for key in e.parameters)]
    return dict(zip(names, np.sqrt(np.diag(np.array(revision.covariance))).tolist(), strict=False)) \
        if revision.covariance else {}  # fmt: skip


def active_effects(declared: ModelRevision, adopted: Iterable[ActiveEffect] = ()) -> tuple[Effect, ...]:
    """Effects of the declared model with their values and spread as prior, then those `adopted` since then.

    How well an adopted one is known beforehand stays as the catalogue says: what it was found on is fitted again.
    """
    known = parameter_std(declared)
    adopted_start = (_around(e, {}) for e in adopted if not e.profile)
    return (*(_around(e, known) for e in declared.effects if not e.profile), *adopted_start)


def _around(active: ActiveEffect, std: Mapping[str, float]) -> Effect:
    """The catalogue's effect; the prior of each parameter is the value it has, `std` by `effect.parameter`."""
    effect = catalogue()[active.name]
    if f"{active.name}.{effect.parameters[0].name}" not in std:
        return replace(effect, initial=tuple(active.parameters[p.name] for p in effect.parameters))
    parameters = tuple(
        replace(p, prior=active.parameters[p.name], prior_std=std[f"{active.name}.{p.name}"]) for p in effect.parameters
    )
    return replace(effect, parameters=parameters, initial=())
