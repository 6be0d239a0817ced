"""Steer lag: the true road-wheel angle follows the reported one as a first-order system does."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from estimator.model.effects.base import Effect
from estimator.model.memory import relaxed
from estimator.model.parameters import Parameter, Plausible
from estimator.model.single_track import Terms
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.process.arrays import Array, Expr


def _input(terms: Terms, time_constant: Expr) -> None:
    first_order = -time_constant * terms.auxiliary("steer_rate")
    terms.steer = terms.steer + terms.aux.get("steer_behind", first_order)


def _prepare(signals: Mapping[str, Array], vehicle: Vehicle, parameters: tuple[float, ...]) -> dict[str, Array]:
    asked = signals["steer"]
    followed = relaxed(signals["t"], asked, np.full(len(asked), parameters[0]))
    return {"steer_behind": followed - asked}


EFFECT = Effect(
    name="steer_lag",
    form_of="steer_delay",
    lacks="true road-wheel angle follows the reported one as a first-order system",
    equation="T d(delta)/dt = delta_reported - delta",
    source="definition",
    parameters=(
        Parameter(
            "time_constant",
            "s",
            0.0,
            0.05,
            0.0,
            0.5,
            "time constant T of the actuator",
            Plausible(0.0, 0.4, "actuators: 0.02 to 0.2 s"),
        ),
    ),
    channels=("ay", "yaw_acc", "vy_dot"),
    cause="steer_rate",
    hooks={"INPUT": _input},
    prepare=_prepare,
    initial=(0.03,),
    remembers=("steer_behind",),
    separated_by="quick steering: a lag rounds its edges, a delay moves them",
)
