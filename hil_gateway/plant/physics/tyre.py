"""Tyres: magic formula with curvature, load sensitivity, slip relaxation and combined slip by similarity.

H. B. Pacejka, Tire and Vehicle Dynamics, 3rd ed. 2012: ch. 4.3 (magic formula), 4.2 (similarity method), 7.2
(relaxation) and 8.6 (standstill). Arguments are CasADi expressions or numbers.
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca

from hil_gateway.process.arrays import Expr

Pair = tuple[Expr, Expr]

LOW_SPEED = 1.0
"""m/s; slip is taken against sqrt(v^2 + LOW_SPEED^2) where the contact patch slides"""
RATE_MAX = 1000.0
"""1/s; the quickest slip can follow, for the 1 kHz integration"""
LEAST_LENGTH = 0.02
"""m of relaxation at least: the tread alone yields by as much"""
STILL = 1e-9
"""m/s; keeps the division of zero by zero at rest finite"""
DAMPING_SPEED = 3.0
"""m/s; below it the contact patch is damped, or a standing car would swing on its tyres for ever"""
DAMPING_X, DAMPING_Y = 0.016, 0.1
"""s/m"""


class Curve(NamedTuple):
    """Coefficients of one magic formula; D is the friction coefficient."""

    B: Expr
    C: Expr
    D: Expr
    E: Expr


def magic_formula(slip: Expr, curve: Curve) -> Expr:
    """Force over load: D sin(C atan(B s - E (B s - atan(B s)))), Pacejka Eq. 4.6."""
    bs = curve.B * slip
    return curve.D * ca.sin(curve.C * ca.atan(bs - curve.E * (bs - ca.atan(bs))))


def peak_slip(curve: Curve) -> Expr:
    """Slip of the largest force for small E: C atan(B s (1 - E) + E atan(B s)) = pi / 2, two fixed-point steps."""
    target = ca.tan(ca.pi / (2.0 * curve.C))
    bs = target
    for _ in range(3):
        bs = (target - curve.E * ca.atan(bs)) / (1.0 - curve.E)
    return bs / curve.B


def friction_factor(load: Expr, nominal: Expr, sensitivity: Expr) -> Expr:
    """Friction at a load over friction at the nominal one: 1 - k (Fz / Fz0 - 1), never below 0.3."""
    return ca.fmax(0.3, 1.0 - sensitivity * (load / nominal - 1.0))


def damped(velocity: Pair, rim: Expr, slip: Pair) -> Pair:
    """Slips with contact damping at walking pace."""
    vx, vy = velocity
    fade = ca.exp(-((vx / DAMPING_SPEED) ** 2))
    return slip[0] + DAMPING_X * fade * (rim - vx), slip[1] - DAMPING_Y * fade * vy


class Tyre(NamedTuple):
    """One tyre under its present load."""

    load: Expr
    along: Curve
    across: Curve
    combined: Expr
    """0..1, from independent forces to the similarity method"""
    saturation: Expr
    """0..1, from longitudinal force linear in slip to the magic formula"""
    stiffness: Expr
    """N per unit slip where the longitudinal force is linear"""


def slip_rates(velocity: Pair, rim: Expr, slip: Pair, length: Pair, tyre: Tyre) -> Pair:
    """Rates of longitudinal slip and of the slip angle's tangent, first order over the relaxation lengths (m).

    `velocity` of the wheel centre along and across the wheel, `rim` circumferential speed, m/s. At rest slip is the
    deflection of the tread over the relaxation length, which stays as it is (Eq. 7.7 for V_x = 0): a standing tyre
    holds what it is loaded with, up to the peak of its force; there it slides, as a bristle does.
    """
    vx, vy = velocity
    sliding = ca.sqrt(((rim - vx) / peak_slip(tyre.along)) ** 2 + (vy / peak_slip(tyre.across)) ** 2 + STILL**2)
    speed = ca.sqrt(vx * vx + ca.fmin(sliding, LOW_SPEED) ** 2)
    rate_x, rate_y = (ca.fmin(speed / ca.fmax(x, LEAST_LENGTH), RATE_MAX) for x in length)
    return rate_x * ((rim - vx) / speed - slip[0]), rate_y * (-vy / speed - slip[1])


def slip_over_peak(slip: Pair, tyre: Tyre) -> Expr:
    """Combined slip over that of the peak force, 1 at the peak (similarity method)."""
    return ca.sqrt((slip[0] / peak_slip(tyre.along)) ** 2 + (ca.atan(slip[1]) / peak_slip(tyre.across)) ** 2)


def forces(slip: Pair, tyre: Tyre) -> Pair:
    """Longitudinal and lateral force, N, from relaxed slips (the second is the tangent of the slip angle).

    Similarity: both slips, each over that of its peak, make one slip; its pure curves give the size of the force
    and its direction the direction.
    """
    load, along, across = tyre.load, tyre.along, tyre.across
    slip_x, angle = slip[0], ca.atan(slip[1])
    linear_x = tyre.stiffness * slip_x
    pure_x = linear_x + tyre.saturation * (load * magic_formula(slip_x, along) - linear_x)
    pure_y = load * magic_formula(angle, across)
    peak_x, peak_y = peak_slip(along), peak_slip(across)
    nx, ny = slip_x / peak_x, angle / peak_y
    size = ca.sqrt(nx * nx + ny * ny + 1e-8)
    similar_x = nx / size * load * magic_formula(size * peak_x, along)
    similar_y = ny / size * load * magic_formula(size * peak_y, across)
    return (
        pure_x + tyre.combined * tyre.saturation * (similar_x - pure_x),
        pure_y + tyre.combined * (similar_y - pure_y),
    )
