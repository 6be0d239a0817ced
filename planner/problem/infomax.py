"""Information in the planner: Eq. (7) as a stage cost of Eq. (9), its convexification, and the belief's sigma points.

The information of one stage is Tr(W F_k) with F_k = H' Sigma_z^-1 H:
- `trace`: W = diag(prior variance) gives the paper's Tr(F) in prior-scaled parameters;
- `log_det`: W = (P^-1 + sum F)^-1, the gradient of the log det of the posterior precision, which does not
  keep paying for what is already known.

-q_I Tr(W F) is concave in places, so a Gauss-Newton method needs help. F depends on the state through drive command
and slip angles y = (d, alpha_f, alpha_r). `abs` keeps the exact gradient and takes
sum_i |d2I/dy_i2| grad y_i grad y_i' as Hessian; `projection` (the reference) takes the exact Hessian with its
negative eigenvalues cut off.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from estimator.belief.information import stage_information
from estimator.belief.tyre_belief import BeliefSettings, measured_std
from estimator.model.measurement import CHANNELS
from hil_gateway.process.arrays import Array, Expr
from planner.problem.motion import STATES
from planner.problem.stage_model import StageModel

LEARNING_SPEED = (12.0, 20.0)
"""m/s between which the weight rises from 0 to q_I: slower, slip angles are noise and the belief's gates are shut"""
PATIENCE_S = 0.4
"""time after which information counts 1/e: undiscounted, plans put the slalom off to their end and none was driven"""
FADE = 1.05
"""the weight begins to fade where the belief is so many times as wide as its goal"""
CAUTION, MIN_SPREAD = 0.2, 0.05
"""spread of the belief over the prior's at which q_I is what is configured, and below which it no longer rises"""
SAMPLES_PER_S = 100.0
"""measurements the belief takes in"""
FORCE_STATES = tuple(map(STATES.index, ("vx", "vy", "yaw_rate", "drive", "steer")))
"""entries of z that tyre forces depend on"""


@dataclass(frozen=True)
class CostTerms:
    """Contribution of -q_I I to one stage; `gain` is Delta I = Tr(F_k) of Eq. (9)."""

    gradient: Expr
    hessian: Expr
    gain: Expr
    exact_hessian: Expr


def no_terms() -> CostTerms:
    """q_I = 0: exactly the plain MPCC."""
    n = len(FORCE_STATES)
    return CostTerms(ca.SX(10, 1), ca.SX(10, 10), ca.SX(1, 1), ca.SX(n, n))


def sigma_points(mean: Array, covariance: Array, indices: tuple[int, ...], level: float) -> Array:
    """Mean and mean +- `level` sigma along each principal axis of the marginal belief of `indices`.

    Returns shape (n_theta, 2 len(indices) + 1); the other parameters stay at the mean. Parameters keep to a tenth
    of their mean at least: a Gaussian reaches below zero, a tyre does not.
    """
    rows = np.array(indices)
    steps = principal_steps(covariance[rows[:, None], rows], level)
    points = np.repeat(mean[:, None], 2 * len(rows) + 1, axis=1)
    points[rows, 1::2] += steps
    points[rows, 2::2] -= steps
    return np.maximum(points, 0.1 * mean[:, None])


def least_of(mean: Array, covariance: Array, indices: tuple[int, ...], which: int, level: float) -> Array:
    """Where parameter `which` is `level` sigma below its mean, and the others of `indices` are likeliest then, (n,).

    Of all choices within `level` sigma the one with the least of that parameter: what sets a force by this parameter
    alone, as braking or driving straight on is by D, sees less of its spread along each single principal axis.
    """
    rows, point = np.array(indices), mean.copy()
    if (variance := float(covariance[which, which])) > 0.0:
        point[rows] -= level * covariance[rows, which] / np.sqrt(variance)
    return np.maximum(point, 0.1 * mean)


def principal_steps(covariance: Array, level: float) -> Array:
    """`level` sigma along each principal axis, column after column, of covariances (..., k, k)."""
    values, axes = np.linalg.eigh(covariance)
    return np.asarray(level * axes * np.sqrt(np.maximum(values, 0.0))[..., None, :])


def information_matrix(problem: StageModel, z: Expr, p: Mapping[str, Expr]) -> Expr:
    """F_k of Eq. (7) in unscaled parameters at a state of the horizon and the belief's mean, shape (n, n)."""
    theta = ca.SX.sym("theta", len(problem.model.tyre_table))
    terms = problem.evaluate(z, theta, p)
    kind = problem.settings.information.kind
    h = ca.vertcat(*(getattr(terms, name) for name in CHANNELS[kind]))
    F = stage_information(h, theta, measured_std(kind, problem.model.vehicle.mass), [1.0] * theta.numel())
    return ca.substitute(F, theta, p["information_theta"])


def trace_gain(problem: StageModel, z: Expr, p: Mapping[str, Expr]) -> Expr:
    """Delta I_k = Tr(F_k) in prior-scaled parameters."""
    return ca.dot(ca.diag(information_matrix(problem, z, p)), p["trace_weight"])


def weighted_gain(problem: StageModel, z: Expr, p: Mapping[str, Expr]) -> Expr:
    """Tr(W F_k)."""
    return ca.dot(ca.vec(information_matrix(problem, z, p)), p["information_weight"])


def cost_terms(problem: StageModel, z: Expr, p: Mapping[str, Expr]) -> CostTerms:
    """Gradient and convex Hessian of -q_I Tr(W F_k) in z, Delta I_k, and the exact Hessian in `FORCE_STATES`."""
    weight, value = p["q_information"] * p["learning"], weighted_gain(problem, z, p)
    exact = _exact_hessian(value, z)
    hessian = ca.SX(z.numel(), z.numel())
    if problem.settings.information.convexification == "abs":
        for gradient, direction in _slip_directions(problem, z, p):
            curvature = ca.fabs(ca.dot(direction, exact @ direction))
            block = curvature * (gradient.T @ gradient)
            for a, i in enumerate(FORCE_STATES):
                for b, j in enumerate(FORCE_STATES):
                    hessian[i, j] += block[a, b]
    gradient = -weight * ca.gradient(value, z)
    return CostTerms(gradient, weight * hessian, trace_gain(problem, z, p), -weight * exact)


def _exact_hessian(value: Expr, z: Expr) -> Expr:
    full: Any = ca.hessian(value, z)[0]
    index = list(FORCE_STATES)
    return full[index, index]


def _slip_directions(problem: StageModel, z: Expr, p: Mapping[str, Expr]) -> list[tuple[Expr, Expr]]:
    """For d, alpha_f, alpha_r: gradient in `FORCE_STATES` and a direction that moves it alone, at unit rate.

    d and delta move d and alpha_f alone; (v_y, omega) along (L_f, -1) leaves alpha_f and moves alpha_r.
    """
    terms = problem.evaluate(z, p["theta"], p)
    lf = problem.model.vehicle.lf
    bases = (ca.DM([0, 0, 0, 1, 0]), ca.DM([0, 0, 0, 0, 1]), ca.DM([0, lf, -1, 0, 0]))
    result = []
    for signal, base in zip((z[7], terms.slip_f, terms.slip_r), bases, strict=True):
        full = ca.jacobian(signal, z)
        gradient = ca.horzcat(*(full[i] for i in FORCE_STATES))
        rate = gradient @ base
        result.append((gradient, base / rate))
    return result


def project(hessians: Array) -> Array:
    """Nearest positive semi-definite matrices (Frobenius norm) of a batch, shape (..., n, n)."""
    values, vectors = np.linalg.eigh(hessians)
    return np.asarray((vectors * np.maximum(values, 0.0)[..., None, :]) @ np.swapaxes(vectors, -1, -2))


def scheduled_weight(weight: float, speed: float, spread: float, goal: float) -> float:
    """q_I of this step from the configured one, the speed (m/s) and what is known already.

    `spread` is that of the belief (`relative_spread`); exploring ends where it reaches `goal`, both over the prior's.
    """
    low, high = LEARNING_SPEED
    gate = float(np.clip((speed - low) / (high - low), 0.0, 1.0))
    need = float(np.clip((spread / goal - 1.0) / (FADE - 1.0), 0.0, 1.0)) if goal > 0 else 1.0
    return weight * gate * need


def caution(spread: float) -> float:
    """Factor of q_I for `log_det`: its gain falls with the square of the belief's spread over the prior's, this rises.

    Information promises most where least is known, and that is where plans go wrong; the last of it is worth more time.
    """
    return CAUTION / max(spread, MIN_SPREAD)


def patience(dt: float, horizon: int) -> Array:
    """Share of q_I at each stage of the horizon (N,): soon counts more than late."""
    return np.asarray(np.exp(-dt / PATIENCE_S * np.arange(horizon)))


def relative_spread(covariance: Array, prior_std: Array) -> float:
    """Geometric mean over the directions of parameter space of standard deviation over that of the prior."""
    sign, log_det = np.linalg.slogdet(covariance / np.outer(prior_std, prior_std))
    return float(np.exp(0.5 * log_det / len(prior_std))) if sign > 0 else 0.0


def independent_samples(dt: float) -> float:
    """How many independent measurements a stage of `dt` s stands for in the belief, whose errors are correlated."""
    return dt * SAMPLES_PER_S / BeliefSettings().correlation_samples
