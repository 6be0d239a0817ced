"""Steering delay: the true actuation lags the reported one.

On recorded data the reported signal is shifted; without a past, u(t - T) is replaced by u - T du/dt, right
to first order in T.
"""

from __future__ import annotations

from collections.abc import Mapping

from estimator.model.effects.base import Array, Effect
from estimator.model.memory import delayed
from estimator.model.parameters import Parameter
from estimator.model.single_track import Terms
from estimator.model.tyre import Expr
from hil_gateway.vehicle import Vehicle


def _input(terms: Terms, delay: Expr) -> None:
    first_order = -delay * terms.auxiliary("steer_rate")
    terms.steer = terms.steer + terms.aux.get("steer_shift", first_order)


def _prepare(signals: Mapping[str, Array], vehicle: Vehicle, parameters: tuple[float, ...]) -> dict[str, Array]:
    return {"steer_shift": delayed(signals["t"], signals["steer"], parameters[0]) - signals["steer"]}


EFFECT = Effect(
    name="steer_delay",
    lacks="true road-wheel angle lags the reported one",
    equation="delta(t) = delta_reported(t - T)",
    source="definition; first-order form by Taylor expansion",
    parameters=(Parameter("delay", "s", 0.0, 0.05, 0.0, 0.5, "true actuation after the reported one"),),
    channels=("ay", "yaw_acc", "vy_dot"),
    hooks={"INPUT": _input},
    prepare=_prepare,
    initial=(0.03,),
    remembers=("steer_shift",),
    separated_by="fast steering at different speeds: a delay is the same at any speed, relaxation shrinks with it",
)
