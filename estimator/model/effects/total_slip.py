"""Total slip: a tyre's force follows its slip vector, so slip along the wheel takes force away across it.

The friction ellipse knows only forces, and near the limit a little more slip changes these little while it turns the
force by a lot. Where the drive command is the slip ratio the tyre really has, the similarity method describes both.
"""

from __future__ import annotations

import casadi as ca

from estimator.model.effect import NO_BRAKES_AHEAD, Effect
from estimator.model.parameters import Parameter, Plausible, Quantity
from estimator.model.single_track import Terms
from hil_gateway.process.arrays import Expr

SMALLEST_SLIP = 1e-5
"""rad; keeps the direction of no slip at all differentiable."""


def _slip(terms: Terms, k_front: Expr, k_rear: Expr, shift: Expr) -> None:
    terms.slip_f, terms.across_f = _total(terms.slip_f, k_front * terms.auxiliary("brake"))
    terms.slip_r, terms.across_r = _total(terms.slip_r, k_rear * (terms.drive - shift))


def _total(across: Expr, along: Expr) -> tuple[Expr, Expr]:
    """Length of the slip vector, with the sign of `across`, and the share of it that is across the wheel."""
    share = ca.sqrt((across * across + SMALLEST_SLIP**2) / (across * across + along * along + SMALLEST_SLIP**2))
    return across / share, share


EFFECT = Effect(
    name="total_slip",
    lacks="the tyre force turns with the slip vector",
    equation="F_y = F_y0(sigma) alpha / sigma, sigma^2 = alpha^2 + kappa^2, kappa_f = k_f p, kappa_r = k_r (d - d_0)",
    source="Pacejka, Tire and Vehicle Dynamics, ch. 3.3 (similarity of combined slip), eq. 4.E65 (shift S_Hyk)",
    parameters=(
        Parameter(
            "k_front",
            "rad",
            0.0,
            0.3,
            0.0,
            3.0,
            "slip of the front axle at full brake",
            Plausible(0.0, 1.5, "slip at full brake, locked is 1"),
        ),
        Parameter(
            "k_rear",
            "1",
            0.0,
            0.5,
            0.0,
            3.0,
            "slip of the rear axle per unit of drive command",
            Plausible(0.0, 2.5, "1 where the command is the slip"),
        ),
        Parameter(
            "shift",
            "1",
            0.0,
            0.02,
            -0.1,
            0.1,
            "drive command of most lateral force at the rear axle",
            Plausible(-0.08, 0.08, "tyres' best slip is a few per cent"),
        ),
    ),
    channels=("ay", "yaw_acc", "vy_dot"),
    cause="drive",
    hooks={"SLIP": _slip},
    initial=(0.1, 0.3, 0.01),
    requires_any=(Quantity.TRACTION_ELLIPSE,),
    unsought_while_driving=NO_BRAKES_AHEAD,
    separated_by="much slip along the wheel at little force, and little slip at the same force",
)
