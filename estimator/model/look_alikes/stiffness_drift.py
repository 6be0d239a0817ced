"""Tyres that stiffen or soften as a run goes on, while their grip stays: in gentle bends it looks like a grip drift.

B times the slip angle is what Eq. (2) knows of either: the slip angle is scaled in place of B.
"""

from __future__ import annotations

import casadi as ca

from estimator.model.effects.base import Effect
from estimator.model.effects.grip_drift import SMALLEST_DECAY
from estimator.model.parameters import Parameter, Plausible
from estimator.model.single_track import Terms
from hil_gateway.process.arrays import Expr


def _slip(terms: Terms, rate: Expr, decay: Expr) -> None:
    x = decay + SMALLEST_DECAY
    factor = 1.0 + rate * (1.0 - ca.exp(-x * terms.auxiliary("t"))) / x
    terms.slip_f, terms.slip_r = terms.slip_f * factor, terms.slip_r * factor


STIFFNESS_DRIFT = Effect(
    name="stiffness_drift",
    form_of="grip_drift",
    lacks="B changes slowly with time",
    equation="B(t) = B_0 (1 + r (1 - exp(-x t)) / x); x = 0: B_0 (1 + r t)",
    source="Pacejka, Tire and Vehicle Dynamics, ch. 4 (cornering stiffness over inflation pressure)",
    parameters=(
        Parameter(
            "rate",
            "1/s",
            0.0,
            1e-3,
            -0.02,
            0.02,
            "relative change of B a second, at the start",
            Plausible(-0.005, 0.005, "half of the stiffness in 100 s is a change of tyres"),
        ),
        Parameter(
            "decay",
            "1/s",
            0.0,
            0.005,
            0.0,
            0.05,
            "inverse time constant; 0: linear",
            Plausible(0.0, 0.04, "a tyre warms through within half a minute at the soonest"),
        ),
    ),
    channels=("ay", "yaw_acc", "vy_dot"),
    cause="t",
    hooks={"SLIP": _slip},
    needs=("t",),
    separated_by="gentle and hard bends early and late in the session",
)
