"""Grip drift: D changes slowly with time (warm-up, wear), settling exponentially or going on linearly."""

from __future__ import annotations

import casadi as ca

from estimator.model.effect import Effect
from estimator.model.parameters import Parameter, Plausible
from estimator.model.single_track import Terms
from hil_gateway.process.arrays import Expr

SMALLEST_DECAY = 1e-7
"""Keeps (1 - exp(-x t)) / x defined at x = 0, where the drift is linear, 1/s."""


def settling(terms: Terms, rate: Expr, decay: Expr) -> Expr:
    """Factor on what changes with time at `rate` (1/s) first, and settles by the inverse time constant `decay`, 1/s."""
    x = decay + SMALLEST_DECAY
    return 1.0 + rate * (1.0 - ca.exp(-x * terms.auxiliary("t"))) / x


def _grip(terms: Terms, rate: Expr, decay: Expr) -> None:
    factor = settling(terms, rate, decay)
    terms.grip_f = terms.grip_f * factor
    terms.grip_r = terms.grip_r * factor


EFFECT = Effect(
    name="grip_drift",
    lacks="D changes slowly with time (warm-up, wear)",
    equation="D(t) = D_0 (1 + r (1 - exp(-x t)) / x); x = 0: D_0 (1 + r t)",
    source="first-order thermal time constant (Kelly & Sharp, Vehicle System Dynamics 50, 2012); linear wear",
    parameters=(
        Parameter(
            "rate",
            "1/s",
            0.0,
            1e-3,
            -0.02,
            0.02,
            "relative change of D a second, at the start",
            Plausible(-0.005, 0.005, "half of the grip in 100 s is a change of tyres, not their wear"),
        ),
        Parameter(
            "decay",
            "1/s",
            0.0,
            0.005,
            0.0,
            0.05,
            "inverse time constant; 0: linear",
            Plausible(0.0, 0.04, "a tread warms up within half a minute at the soonest"),
        ),
    ),
    channels=("ay", "yaw_acc", "vy_dot"),
    cause="t",
    hooks={"GRIP": _grip},
    needs=("t",),
    unsought_while_driving="it needs the time since the start of the log",
    separated_by="the same corner at the same speed early and late in the session",
)
