"""Tyre relaxation: lateral force builds up over a rolled distance, the relaxation length.

On recorded data the slip angles are passed through the first-order lag sigma / v; without a past the lag is
left out: at racing speed sigma / v is 10 ms, below the planner's step.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from estimator.model.effect import Effect
from estimator.model.memory import SLOWEST, followed, relaxed
from estimator.model.parameters import Parameter, Plausible
from estimator.model.single_track import Terms
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.process.arrays import Array, Expr


def _slip(terms: Terms, length: Expr) -> None:
    terms.slip_f = terms.slip_f + terms.aux.get("relaxation_f", 0.0 * length)
    terms.slip_r = terms.slip_r + terms.aux.get("relaxation_r", 0.0 * length)


def _prepare(signals: Mapping[str, Array], vehicle: Vehicle, parameters: tuple[float, ...]) -> dict[str, Array]:
    slips = np.stack([followed(signals, "steer") - signals["course_f"], -signals["course_r"]])
    lag = relaxed(signals["t"], slips, parameters[0] / np.maximum(signals["vx"], SLOWEST)) - slips
    return dict(zip(("relaxation_f", "relaxation_r"), lag, strict=True))


EFFECT = Effect(
    name="tyre_relaxation",
    lacks="lateral force builds up over a length",
    equation="sigma / v_x d(alpha')/dt + alpha' = alpha",
    source="Pacejka, Tire and Vehicle Dynamics, eq. 7.25",
    parameters=(
        Parameter(
            "length",
            "m",
            0.0,
            0.4,
            0.0,
            5.0,
            "relaxation length sigma",
            Plausible(0.0, 3.0, "half to two wheel circumferences"),
        ),
    ),
    channels=("ay", "yaw_acc", "vy_dot"),
    cause="steer_rate",
    hooks={"SLIP": _slip},
    prepare=_prepare,
    lags=True,
    initial=(0.3,),
    remembers=("relaxation_f", "relaxation_r"),
    separated_by="the same quick steering at different speeds: the lag falls with speed, a delay does not",
)
