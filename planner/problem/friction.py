"""How much of a tyre's force along the wheels counts beside the force across: the shape of the friction ellipse.

Tyres bear more along than across: the load of an axle stays on both wheels while it brakes straight on, and slicks grip
better that way. In a bend the inner wheel, braked as hard as the outer one, has less load and locks first. So the
difference counts while braking on a straight, and is gone where an axle is cornering. It does not count for traction: a
driven axle at its peak is what turns a car round.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from estimator.model.parameters import Quantity
from estimator.model.single_track import SingleTrack
from hil_gateway.process.arrays import Array, Expr

BELIEVED = 0.5
"""of the difference that combined slip shows: it is felt beside cornering, the peak along the wheels never"""
LEAST = 0.7
"""of lateral over longitudinal friction that is believed"""
CORNERING = 0.5
"""share of the lateral peak at which the inner wheel has lost its part of the difference"""
SWITCH = 300.0
"""N of force between braking and driving"""


def along_share(model: SingleTrack, phi: Expr) -> Expr:
    """What braking counts on a straight, of what it would on a circle; 1 where no combined slip is modelled."""
    place = model.place_of(Quantity.FRICTION_ELLIPSE)
    if place is None:
        return 1.0
    return 1.0 - BELIEVED * (1.0 - ca.fmin(ca.fmax(phi[place], LEAST), 1.0))


def counted(share: Expr, across: Expr, force: Expr) -> Expr:
    """What a `force` along, N, negative when braking, counts beside one of `across` times the peak."""
    return 1.0 - (1.0 - share) * _straight(across) * _braking(force)


def _straight(across: Expr) -> Expr:
    """1 on a straight, 0 in a bend that takes `across` times the peak."""
    return 1.0 - ca.fmin((across / CORNERING) ** 2, 1.0)


def doubted(doubt: Expr, force: Expr) -> Expr:
    """What a `force` along, N, counts, of brakes that count `doubt` times (`planner.adoption.brake_doubt`)."""
    return 1.0 + (doubt - 1.0) * _braking(force)


def _braking(force: Expr) -> Expr:
    """1 where a `force` along, N, brakes, 0 where it drives."""
    return 0.5 * (1.0 - ca.tanh(force / SWITCH))


ACROSS = np.sin(np.linspace(0.0, 0.5 * np.pi, 101))
STRAIGHT = np.array([float(_straight(across)) for across in ACROSS])


def left_across(share: float, along: Array) -> Array:
    """Share of the lateral peak that is left beside braking forces `along`, times the peak: sqrt(1 - x^2) on a circle,
    which a `share` of 1 is."""
    most = np.sqrt(1.0 - ACROSS**2) / (1.0 - (1.0 - share) * STRAIGHT)
    return np.asarray(np.interp(along, most[::-1], ACROSS[::-1]))
