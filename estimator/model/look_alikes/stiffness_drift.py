"""Tyres that stiffen or soften as a run goes on, while their grip stays: in gentle bends it looks like a grip drift.

B times the slip angle is what Eq. (2) knows of either: the slip angle is scaled in place of B, by the law of the drift.
"""

from __future__ import annotations

from dataclasses import replace

from estimator.model.effects.grip_drift import EFFECT as GRIP_DRIFT
from estimator.model.effects.grip_drift import settling
from estimator.model.single_track import Terms
from hil_gateway.process.arrays import Expr


def _slip(terms: Terms, rate: Expr, decay: Expr) -> None:
    factor = settling(terms, rate, decay)
    terms.slip_f, terms.slip_r = terms.slip_f * factor, terms.slip_r * factor


_RATE, _DECAY = GRIP_DRIFT.parameters
STIFFNESS_DRIFT = replace(
    GRIP_DRIFT,
    name="stiffness_drift",
    form_of=GRIP_DRIFT,
    lacks="B changes slowly with time",
    equation="B(t) = B_0 (1 + r (1 - exp(-x t)) / x); x = 0: B_0 (1 + r t)",
    source="Pacejka, Tire and Vehicle Dynamics, ch. 4 (cornering stiffness over inflation pressure)",
    parameters=(replace(_RATE, description="relative change of B a second, at the start"), _DECAY),
    hooks={"SLIP": _slip},
    separated_by="gentle and hard bends early and late in the session",
)
