"""Engine braking: drag torque at the driven axle with the throttle closed.

Closed is what the throttle says where it is recorded, else the slip-ratio command. On recorded data the switch is
taken sample by sample: a pedal that flutters about zero is closed half of the time, whatever its mean. Where on the
pedal the engine begins to pull differs from car to car and is learnt; a driver may hold a corner just there.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca
import numpy as np

from estimator.model.effect import Effect
from estimator.model.memory import followed
from estimator.model.parameters import Parameter, Plausible
from estimator.model.single_track import Terms
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.process.arrays import Array, Expr

CLOSED_BELOW, WIDTH = 0.0005, 0.0005
"""Slip-ratio command below which the throttle counts as closed, and the width of the switch."""
STEEPNESS = 4.0
"""The switch of the pedal is so many times narrower than it is away from 0: then 0 is closed for certain."""


def _longitudinal(terms: Terms, force: Expr, pedal: Expr) -> None:
    by_command = 0.5 * (1.0 - ca.tanh((terms.drive - CLOSED_BELOW) / WIDTH))
    terms.fx_r = terms.fx_r - force * terms.aux.get("throttle_closed", by_command)


def _prepare(signals: Mapping[str, Array], vehicle: Vehicle, parameters: tuple[float, ...]) -> dict[str, Array]:
    if "throttle" in signals:
        open_by = signals["throttle"] / parameters[1] - 1.0
        return {"throttle_closed": 0.5 * (1.0 - np.tanh(STEEPNESS * open_by))}
    return {"throttle_closed": (followed(signals, "drive") < CLOSED_BELOW).astype(float)}


EFFECT = Effect(
    name="engine_braking",
    lacks="drag torque with the throttle closed",
    equation="F_x,r = C_x d - F_e [d <= 0]",
    source="Gillespie, Fundamentals of Vehicle Dynamics, ch. 2",
    parameters=(
        Parameter(
            "force",
            "N",
            0.0,
            300.0,
            0.0,
            5000.0,
            "drag of the closed-throttle engine at the wheels",
            Plausible(
                0.0,
                3000.0,
                "a closed engine of 2 to 3 l in low gear: up to 2 kN; a gearbox takes tens of newtons",
                40.0,
            ),
        ),
        Parameter(
            "pedal",
            "1",
            0.02,
            0.01,
            0.002,
            0.2,
            "throttle at which half of it is gone, where it is recorded",
            Plausible(0.003, 0.15, "free travel and idle of a pedal; beyond it the engine pulls"),
        ),
    ),
    channels=("ax", "vx_dot"),
    cause="drive",
    hooks={"LONGITUDINAL": _longitudinal},
    prepare=_prepare,
    remembers=("throttle_closed",),
    separated_by="coasting with closed throttle against light throttle at the same speed",
)
