"""A brake that goes on dragging after it is released: it slows the car as rolling resistance does, but not for long.

Braking has a gain of its own, as front brakes would give it.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from estimator.model.effect import Effect, braking_part
from estimator.model.effects.rolling_resistance import EFFECT as ROLLING_RESISTANCE
from estimator.model.memory import followed, held
from estimator.model.parameters import Parameter, Plausible
from estimator.model.single_track import Terms
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.process.arrays import Array, Expr


def _input(terms: Terms, kept: Expr, time_constant: Expr, gain: Expr) -> None:
    braking = braking_part(terms.drive)
    dragging = terms.aux.get("brake_held", 0.0 * time_constant)
    terms.drive = terms.drive + (gain - 1.0) * braking - kept * dragging


def _prepare(signals: Mapping[str, Array], vehicle: Vehicle, parameters: tuple[float, ...]) -> dict[str, Array]:
    braking = np.maximum(-followed(signals, "drive"), 0.0)
    return {"brake_held": held(signals["t"], braking, parameters[1]) - braking}


BRAKE_DRAG = Effect(
    name="brake_drag",
    form_of=ROLLING_RESISTANCE,
    lacks="the brakes go on dragging after they are released",
    equation="d = d_reported - k (h - b), b = max(-d_reported, 0), h = max(b, h_before exp(-dt / T)); braking times q",
    source="Limpert, Brake Design and Safety, ch. 5 (residual drag after release)",
    parameters=(
        Parameter(
            "kept",
            "1",
            0.0,
            0.1,
            0.0,
            1.0,
            "share of the braking that stays as it is released",
            Plausible(0.0, 0.6, "one brake of the four, or a residual pressure; more and the driver stops", 0.02),
        ),
        Parameter(
            "time_constant",
            "s",
            3.0,
            2.0,
            0.3,
            60.0,
            "time constant T of its release",
            Plausible(0.5, 20.0, "faster is a lag of the brakes, slower drags all the lap as rolling resistance does"),
        ),
        Parameter("gain", "1", 1.0, 0.3, 0.1, 10.0, "braking over driving force per unit of slip command", tells=False),
    ),
    channels=("ax", "vx_dot"),
    cause="t",
    hooks={"INPUT": _input},
    needs=("t",),
    prepare=_prepare,
    remembers=("brake_held",),
    separated_by="coasting just after braking and long after it",
)
