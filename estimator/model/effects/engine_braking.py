"""Engine braking: drag torque at the driven axle with the throttle closed.

Closed is what the throttle says where it is recorded; the slip-ratio command alone cannot tell light throttle
from none. A signal that is missing reads 0, so that the command alone then decides.
"""

from __future__ import annotations

import casadi as ca

from estimator.model.effects.base import Effect
from estimator.model.parameters import Parameter
from estimator.model.single_track import Terms
from estimator.model.tyre import Expr

CLOSED_BELOW, WIDTH = 0.001, 0.0005
"""Slip-ratio command below which the throttle counts as closed, and the width of the switch."""
PEDAL_BELOW, PEDAL_WIDTH = 0.02, 0.005
"""The same for the throttle, 0..1."""


def _below(value: Expr, limit: float, width: float) -> Expr:
    return 0.5 * (1.0 - ca.tanh((value - limit) / width))


def _longitudinal(terms: Terms, force: Expr) -> None:
    pedal = _below(terms.auxiliary("throttle"), PEDAL_BELOW, PEDAL_WIDTH)
    terms.fx_r = terms.fx_r - force * pedal * _below(terms.drive, CLOSED_BELOW, WIDTH)


EFFECT = Effect(
    name="engine_braking",
    lacks="drag torque with the throttle closed",
    equation="F_x,r = C_x d - F_e [d <= 0]",
    source="Gillespie, Fundamentals of Vehicle Dynamics, ch. 2",
    parameters=(Parameter("force", "N", 0.0, 300.0, 0.0, 5000.0, "drag of the closed-throttle engine at the wheels"),),
    channels=("ax", "vx_dot"),
    hooks={"LONGITUDINAL": _longitudinal},
    separated_by="coasting with closed throttle against light throttle at the same speed",
)
