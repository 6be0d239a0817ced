"""Engine braking: drag torque at the driven axle with the throttle closed.

Closed is what the throttle says where it is recorded, else the slip-ratio command. On recorded data the switch is
taken sample by sample: a pedal that flutters about zero is closed half of the time, whatever its mean.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from estimator.model.effects.base import Array, Effect
from estimator.model.parameters import Parameter
from estimator.model.single_track import Terms
from estimator.model.tyre import Expr
from hil_gateway.vehicle import Vehicle

CLOSED_BELOW, WIDTH = 0.0005, 0.0005
"""Slip-ratio command below which the throttle counts as closed, and the width of the switch."""
PEDAL_BELOW = 0.02
"""The same for the throttle, 0..1."""


def _longitudinal(terms: Terms, force: Expr) -> None:
    by_command = 0.5 * (1.0 - ca.tanh((terms.drive - CLOSED_BELOW) / WIDTH))
    terms.fx_r = terms.fx_r - force * terms.aux.get("throttle_closed", by_command)


def _prepare(signals: Mapping[str, Array], vehicle: Vehicle, parameters: tuple[float, ...]) -> dict[str, Array]:
    if "throttle" in signals:
        return {"throttle_closed": (signals["throttle"] < PEDAL_BELOW).astype(float)}
    drive = signals["drive"] + signals.get("drive_shift", 0.0)
    return {"throttle_closed": (drive < CLOSED_BELOW).astype(float)}


EFFECT = Effect(
    name="engine_braking",
    lacks="drag torque with the throttle closed",
    equation="F_x,r = C_x d - F_e [d <= 0]",
    source="Gillespie, Fundamentals of Vehicle Dynamics, ch. 2",
    parameters=(Parameter("force", "N", 0.0, 300.0, 0.0, 5000.0, "drag of the closed-throttle engine at the wheels"),),
    channels=("ax", "vx_dot"),
    cause="drive",
    hooks={"LONGITUDINAL": _longitudinal},
    prepare=_prepare,
    remembers=("throttle_closed",),
    separated_by="coasting with closed throttle against light throttle at the same speed",
)
