"""What an effect is: physics hooked into stages of the single-track model, with its parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import casadi as ca

from estimator.model.parameters import Parameter, Quantity, of_size
from hil_gateway.car.car import Car
from hil_gateway.car.vehicle import GRAVITY, Vehicle
from hil_gateway.process.arrays import Array

Hook = Callable[..., None]
"""hook(terms, *parameters) changes the working set of the model in place."""

Prepare = Callable[[Mapping[str, Array], Any, tuple[float, ...]], dict[str, Array]]
"""prepare(signals, vehicle, parameters) -> auxiliary signals that depend on the past, for fits on recorded data."""


ESTIMATED = "the state filter estimates it itself"
NO_BRAKES_AHEAD = "it needs the brakes' pressure, which no plan knows"
NOT_DRIVEN_WITH = "no laps are driven with it yet"
"""Why a running loop does not look for an effect."""

VY_SENSOR = "vy_sensor"
"""place, turn and bias of a sensor of vy, fitted where a log has one beside the centre of gravity"""


@dataclass(frozen=True)
class DeclaredParameter:
    """Value and standard deviation, SI, of one parameter of an effect of the race car.

    `over`: the tyre parameter that it is a ratio to; its own deviation comes on top of that one's.
    """

    value: float
    std: float
    over: str = ""


Declare = Callable[[Car], tuple[DeclaredParameter, ...]]
"""declare(car) -> what a data sheet says of each parameter, in order"""


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
    requires_any: tuple[Quantity, ...] = ()
    """of which an active effect must have at least one for this one to show"""
    separated_by: str = ""
    """manoeuvre or channel that tells it from its look-alikes"""
    form_of: Effect | None = None
    """another effect of which this one is a second form: the same part of the car told by another signal"""
    on_every_car: bool = False
    """whether every car with tyres, brakes and a body has it, to some size"""
    lags: bool = False
    """whether it delays: by less than the sampling of a log it is none"""
    shifts: str = ""
    """input that it delays as a whole, as the sampling of a log does within a row"""
    judged_by: tuple[str, ...] = ()
    """channels of which a fit must use one to judge it, where that is not one of `channels`"""
    hidden_by: str = ""
    """what a fit has for some logs always, and this effect cannot be told from"""
    constant_at: str = ""
    """place of the model (`estimator.offline.predict.places`) at which a constant is this effect"""
    estimated_by_filter: bool = False
    """whether the state filter estimates it itself while driving"""
    unsought_while_driving: str = ""
    """why a running loop does not look for it; empty where it does"""
    fitted_with_tyres: Literal["", "loads", "forces"] = ""
    """of what on a fast car tyres are identified beside: axle loads, or forces, for which the loads must be known"""
    as_logged: Effect | None = None
    """the same by signals of a log that are no part of the model"""
    declare: Declare | None = None
    """what the data sheet of a race car says of it"""

    def __post_init__(self) -> None:
        assert self.parameters, f"effect {self.name} has no parameters"
        assert not self.profile or len(self.parameters) == 1, f"profile {self.name} has one value at a point"

    @property
    def id(self) -> str:
        """Name it is reported under; of the forms of one effect a model has one at most."""
        return self.form_of.name if self.form_of else self.name

    @property
    def moves_the_car(self) -> bool:
        """Whether a planner can drive with it; not so with the mounting of an accelerometer, which is fitted so that
        nothing else stands in for it."""
        return not self.hooks.keys() <= {"SENSOR"}

    def row_of(self, quantity: Quantity) -> int | None:
        """Position of a quantity among its parameters; None where it has no such."""
        return next((i for i, p in enumerate(self.parameters) if p.quantity is quantity), None)

    def neutral(self) -> tuple[float, ...]:
        """Parameter values at the prior mean, where the declared model is unchanged."""
        return tuple(p.prior for p in self.parameters)

    def of_size(self, vehicle: Vehicle) -> Effect:
        """The same with ranges and starts for a car as heavy and as long as `vehicle`."""
        sized = tuple(of_size(p, vehicle) for p in self.parameters)
        factors = [of_size(replace(p, prior=1.0), vehicle).prior for p in self.parameters]
        initial = tuple(value * factor for value, factor in zip(self.initial, factors, strict=False))
        return replace(self, parameters=sized, initial=initial)

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


SWITCHING_SHARE = 0.0026
"""The change of a longitudinal force from driving to braking is smooth within about this share of the weight."""
BRAKING_WIDTH = 1e-3
"""The change from driving to braking is smooth within about this slip command."""


def braking_force(force: Any, vehicle: Vehicle) -> Any:
    """What of a longitudinal force, N, brakes, at most 0."""
    return smooth_negative_part(force, SWITCHING_SHARE * vehicle.mass * GRAVITY)


def braking_part(command: Any) -> Any:
    """What of a slip command brakes, at most 0."""
    return smooth_negative_part(command, BRAKING_WIDTH)
