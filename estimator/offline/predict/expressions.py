"""The functions of a model that a predictor evaluates: channels, and their derivatives by all that is fitted.

A search fits the same model again and again, on all windows and on part of them: its functions are built once.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any

import casadi as ca

from estimator.model.effect import Effect, Hook
from estimator.model.single_track import AUXILIARY, SIGNALS, SingleTrack, Terms
from estimator.offline.predict.compiled_columns import CompiledColumns
from estimator.offline.record.record import STATE_ROWS
from hil_gateway.process.arrays import Expr

STATES = len(STATE_ROWS)
"""vx, vy, yaw_rate: the first of `SIGNALS`, and the integrals of the last three channels (other order)."""
KEPT = 48
"""Models whose functions are kept: more than a round of a search tries, and 50 MB at most."""


@dataclass(frozen=True)
class ModelExpressions:
    """Functions of `inputs` (`SIGNALS`, `AUXILIARY`, signals that effects remember, values of profiles) and `theta`.

    `theta` are the parameters that are the same for all samples; `by` what `channels` are differentiated by: states,
    `theta`, values of profiles, signals that are remembered.
    """

    inputs: Expr
    theta: Expr
    channels: Expr
    by: Expr

    @cached_property
    def values(self) -> CompiledColumns:
        """(5, n) channels."""
        return self._columns("values")

    @cached_property
    def by_states(self) -> CompiledColumns:
        """(5 + 5 * 3, n) channels, then their derivatives by one state after the other."""
        return self._columns("by_states", self.by[:STATES])

    @cached_property
    def derivatives(self) -> CompiledColumns:
        """The same, by all of `by`."""
        return self._columns("derivatives", self.by)

    def _columns(self, name: str, by: Expr | None = None) -> CompiledColumns:
        jacobian = () if by is None else (ca.vec(ca.densify(ca.jacobian(self.channels, by))),)
        full = ca.densify(ca.vertcat(self.channels, *jacobian))
        return CompiledColumns(ca.Function(name, [self.inputs, self.theta], [full], {"cse": True}))


def functions_of(model: SingleTrack) -> ModelExpressions:
    """The functions of a model, built or as they were built before."""
    return _functions(_Form(model.vehicle, model.layout, tuple(_form_of(e) for e in model.effects), model))


def memory_names(model: SingleTrack) -> tuple[str, ...]:
    """Signals that the effects with memory make, in the order of the inputs."""
    return tuple(name for effect in model.effects if effect.prepare for name in effect.remembers)


@dataclass(frozen=True)
class _Form:
    """What the equations of a model depend on, and the model."""

    vehicle: Any
    layout: str
    effects: tuple[Any, ...]
    model: SingleTrack = field(compare=False)


def _form_of(effect: Effect) -> tuple[Any, ...]:
    """An effect as its equations see it; the same for one that came from another process."""
    hooks = tuple((stage, *_identity_of(hook)) for stage, hook in sorted(effect.hooks.items()))
    return effect.name, len(effect.parameters), bool(effect.profile), effect.prepare is None, hooks


def _identity_of(hook: Hook) -> tuple[Any, ...]:
    """A partial function is equal to none but itself."""
    return getattr(hook, "func", hook), *getattr(hook, "args", ())


@lru_cache(KEPT)
def _functions(form: _Form) -> ModelExpressions:
    model = form.model
    names = (*SIGNALS, *AUXILIARY, *memory_names(model))
    profiles = sum(bool(effect.profile) for effect in model.effects)
    constants = sum(len(effect.parameters) for effect in model.effects if not effect.profile)
    inputs = ca.SX.sym("inputs", len(names) + profiles)
    theta = ca.SX.sym("theta", len(model.tyre_table) + constants)
    parts, given = ca.vertsplit(theta), ca.vertsplit(inputs)
    aux = dict(zip(names[len(SIGNALS) :], given[len(SIGNALS) : len(names)], strict=True))
    terms = Terms(model.vehicle, **dict(zip(SIGNALS, given, strict=False)), aux=aux)
    points, along = iter(parts[len(model.tyre_table) :]), iter(given[len(names) :])
    phi = [next(along) if e.profile else next(points) for e in model.effects for _ in e.parameters]
    model.evaluate(terms, parts[: len(model.tyre_table)], phi)
    remembered = given[len(SIGNALS) + len(AUXILIARY) : len(names)]
    by = ca.vertcat(*given[:STATES], theta, *given[len(names) :], *remembered)
    return ModelExpressions(inputs, theta, ca.vertcat(*terms.channels()), by)
