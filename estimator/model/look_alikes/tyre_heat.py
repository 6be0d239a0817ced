"""Grip that changes with the heat of the tyres: in the mean over minutes a drift, within a lap what was driven before.

Sliding heats a tyre by F_y^2 v / C_alpha and the air cools it nearly in proportion to v: its temperature follows the
square of the lateral acceleration, late by its time constant.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from estimator.model.effect import Effect
from estimator.model.effects.grip_drift import EFFECT as GRIP_DRIFT
from estimator.model.memory import relaxed
from estimator.model.parameters import Parameter, Plausible
from estimator.model.single_track import Terms
from hil_gateway.car.vehicle import GRAVITY, Vehicle
from hil_gateway.process.arrays import Array, Expr


def _grip(terms: Terms, change: Expr, time_constant: Expr) -> None:
    heat = terms.aux.get("tyre_heat", 0.0 * time_constant)
    terms.grip_f, terms.grip_r = terms.grip_f * (1 + change * heat), terms.grip_r * (1 + change * heat)


def _prepare(signals: Mapping[str, Array], vehicle: Vehicle, parameters: tuple[float, ...]) -> dict[str, Array]:
    sliding = (signals["vx"] * signals["yaw_rate"] / GRAVITY) ** 2
    return {"tyre_heat": relaxed(signals["t"], sliding, np.full(len(sliding), parameters[1]))}


TYRE_HEAT = Effect(
    name="tyre_heat",
    form_of=GRIP_DRIFT,
    lacks="D changes with the heat of the tyres",
    equation="D = D_0 (1 + c h), T dh/dt = (a_y / g)^2 - h",
    source="Kelly & Sharp, Vehicle System Dynamics 50, 2012 (heat by sliding, cooled by the air)",
    parameters=(
        Parameter("change", "1", 0.0, 0.1, -0.9, 0.9, "relative change of D by cornering at 1 g for long"),
        Parameter(
            "time_constant",
            "s",
            60.0,
            40.0,
            5.0,
            600.0,
            "time constant T of the heat",
            Plausible(10.0, 150.0, "treads warm up within 10 s, carcasses within two minutes; slower is a drift"),
        ),
    ),
    channels=("ay", "yaw_acc", "vy_dot"),
    cause="ay",
    hooks={"GRIP": _grip},
    needs=("t",),
    prepare=_prepare,
    remembers=("tyre_heat",),
    separated_by="the same corner after straights and after other corners",
)
