"""What an effect is: physics hooked into stages of the single-track model, with its parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca

from estimator.model.parameters import Parameter
from hil_gateway.process.arrays import Array

Hook = Callable[..., None]
"""hook(terms, *parameters) changes the working set of the model in place."""

Prepare = Callable[[Mapping[str, Array], Any, tuple[float, ...]], dict[str, Array]]
"""prepare(signals, vehicle, parameters) -> auxiliary signals that depend on the past, for fits on recorded data."""


@dataclass(frozen=True)
class Effect:
    """One physical effect.

    `hooks` maps a stage name of `single_track.Stage` to its equation; `channels` are the residual channels it
    acts on; `needs` are auxiliary signals without which it cannot be evaluated.

    Two kinds need more than a point in time. An effect with memory (delay, relaxation) also has `prepare`: on
    recorded data it computes the delayed signal from the past and hands it in as an auxiliary signal; where
    there is no past (planner) the hook uses its first-order form. An effect with a `profile` has one
    parameter, its value at the point; over the lap that value is a periodic spline of the named signal
    (`estimator.model.profile`), whose coefficients are what is learnt.
    """

    name: str
    lacks: str
    equation: str
    source: str
    parameters: tuple[Parameter, ...]
    channels: tuple[str, ...]
    hooks: Mapping[str, Hook]
    cause: str = ""
    """signal its residual depends on; a nuisance has none"""
    needs: tuple[str, ...] = ()
    initial: tuple[float, ...] = ()
    """start of a fit where the neutral value is a stationary point; default: the prior"""
    profile: str = ""
    prepare: Prepare | None = None
    remembers: tuple[str, ...] = ()
    """auxiliary signals that `prepare` makes"""
    requires_any: tuple[str, ...] = ()
    """effects of which at least one must be active for this one to show"""
    separated_by: str = ""
    """manoeuvre or channel that tells it from its look-alikes"""
    form_of: str = ""
    """another effect of which this one is a second form: the same part of the car told by another signal"""
    on_every_car: bool = False
    """whether every car with tyres, brakes and a body has it, to some size"""

    def __post_init__(self) -> None:
        assert self.parameters, f"effect {self.name} has no parameters"
        assert not self.profile or len(self.parameters) == 1, f"profile {self.name} has one value at a point"

    @property
    def id(self) -> str:
        """Name it is reported under; of the forms of one effect a model has one at most."""
        return self.form_of or self.name

    def neutral(self) -> tuple[float, ...]:
        """Parameter values at the prior mean, where the declared model is unchanged."""
        return tuple(p.prior for p in self.parameters)

    def start(self) -> tuple[float, ...]:
        """Parameter values from which a fit starts."""
        return self.initial or self.neutral()


FRICTION_FLOOR = 0.02
"""Smallest squared share of a force that the friction ellipse leaves: keeps the root differentiable."""


def friction_left(k: Any, force: Any, peak: Any) -> Any:
    """Share of a tyre force that a perpendicular `force` leaves, sqrt(1 - (k force / peak)^2); exactly 1 at k = 0."""
    return _ellipse(k * force / peak) / _ellipse(0.0)


def _ellipse(used: Any) -> Any:
    rest = 1.0 - used * used
    return ca.sqrt(0.5 * (rest + ca.sqrt(rest * rest + FRICTION_FLOOR * FRICTION_FLOOR)))


def smooth_sign(value: Any, width: float) -> Any:
    """Sign of `value`, smooth within about +-`width` of zero, odd."""
    return value / ca.sqrt(value * value + width * width)


def smooth_negative_part(value: Any, width: float) -> Any:
    """min(value, 0), smooth within about +-`width` of zero; exactly 0 at 0, at most width / 2 above elsewhere."""
    return 0.5 * (value - ca.sqrt(value * value + width * width) + width)


BRAKING_WIDTH = 1e-3
"""The change from driving to braking is smooth within about this slip command."""
SWITCHING_FORCE = 20.0
"""The same of a longitudinal force, N."""


def braking_part(command: Any) -> Any:
    """What of a slip command brakes, at most 0."""
    return smooth_negative_part(command, BRAKING_WIDTH)
