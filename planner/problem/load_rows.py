"""Eq. (10): the load of each axle over its bound, for the least favourable choice of theta.

The bound is a share of the peak force of the very tyre that carries the load: a choice of theta with less grip bears
less and has less to bear. So a row is the share of its tyres' peak that an axle uses if theta is right, and the worst
of the choices is what it uses with the stated probability.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca

from estimator.model.single_track import Terms
from estimator.model.tyre import front_and_rear
from hil_gateway.process.arrays import Expr
from planner.problem.friction import along_share, counted, doubted
from planner.problem.motion import NZ, VX, dynamic_share
from planner.problem.stage_model import StageModel

LOAD_SMOOTHING = 0.02
"""rounds the tip of the friction cone at zero force, share of the bound"""

BEYOND_PEAK = 1.0
"""rise of a row with C atan(B alpha) beyond the peak, 1/rad: as steep as it is at no slip, so that plans lead back"""


@dataclass(frozen=True)
class LoadRow:
    """Load of one axle over its bound, its gradient (1, NZ) and the curvature of the ellipse in z (NZ, NZ)."""

    value: Expr
    gradient: Expr
    curvature: Expr


def load_row(problem: StageModel, axle: str, z: Expr, theta: Expr, p: Mapping[str, Expr]) -> LoadRow:
    """Eq. (10) over its bound: friction ellipse, or the signed sum of the paper (`literal`).

    The ellipse is a convex function of the two forces. Its linearisation is flat across the force that is
    small, where the next iteration would run away; adding its curvature times the multiplier of the row to the
    Hessian (sequential convex quadratic programming, Verschueren et al. 2016) makes the iterations contract.
    """
    terms = problem.evaluate(z, theta, p)
    bound = p["load_max"]["fr".index(axle)] * getattr(terms, f"peak_{axle}")
    # driven kinematically, a car has no slip angles to limit
    across = dynamic_share(z[VX]) * getattr(terms, f"across_{axle}") * _lateral_share(problem, axle, terms, theta)
    along = getattr(terms, f"fx_{axle}")
    along *= doubted(p["brake_doubt"]["fr".index(axle)], along)
    along *= counted(along_share(problem.model, p["phi"]), across, along)
    forces = ca.vertcat(along / bound, across / p["load_max"]["fr".index(axle)])
    slopes: Any = ca.jacobian(forces, z)
    if problem.settings.load_limit == "literal":
        ones = ca.DM([[1.0, 1.0]])
        return LoadRow(ca.sum1(forces), ones @ slopes, ca.SX(NZ, NZ))
    value: Any = ca.sqrt(ca.sumsqr(forces) + LOAD_SMOOTHING**2)
    normal = forces / value
    curvature = (ca.SX.eye(2) - normal @ normal.T) / value
    return LoadRow(value, normal.T @ slopes, slopes.T @ curvature @ slopes)


def _lateral_share(problem: StageModel, axle: str, terms: Terms, theta: Expr) -> Expr:
    """Lateral force over the peak by Eq. (2), and on beyond the peak, where the force falls and a row must not."""
    model = problem.model
    rows = front_and_rear(model.layout)["fr".index(axle)].rows([p.name for p in model.tyre_table])
    b, c = (theta[row] for row in rows[:2])
    phase = c * ca.atan(b * getattr(terms, f"slip_{axle}"))
    rising: Any = ca.fmax(ca.fmin(phase, 0.5 * ca.pi), -0.5 * ca.pi)
    return getattr(terms, f"left_{axle}") * ca.sin(rising) + BEYOND_PEAK * (phase - rising)


def worst_choice(problem: StageModel, axle: str, z: Expr, p: Mapping[str, Expr]) -> Expr:
    """The choice of theta in Eq. (10) that loads the axle most, (n_theta, 1)."""
    theta = ca.SX.sym("theta", len(problem.model.tyre_table))
    row = load_row(problem, axle, z, theta, p).value
    points = ca.horzsplit(ca.reshape(p[f"sigma_{axle}"], theta.numel(), -1))
    chosen: Any
    largest: Any
    chosen, largest = points[0], ca.fabs(ca.substitute(row, theta, points[0]))
    for point in points[1:]:
        value = ca.fabs(ca.substitute(row, theta, point))
        chosen = ca.if_else(value > largest, point, chosen)
        largest = ca.fmax(value, largest)
    return chosen


def worst_load(problem: StageModel, axle: str, z: Expr, p: Mapping[str, Expr]) -> LoadRow:
    """The row at the choice of theta where it is largest.

    The gradient of a maximum is that of the member attaining it, so the choice is made on values only.
    """
    theta = ca.SX.sym("theta", len(problem.model.tyre_table))
    row, chosen = load_row(problem, axle, z, theta, p), worst_choice(problem, axle, z, p)
    return LoadRow(*(ca.substitute(part, theta, chosen) for part in (row.value, row.gradient, row.curvature)))
