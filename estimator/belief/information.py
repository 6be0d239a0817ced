"""Fisher information of the tyre parameters, Eq. (6) and (7), and scalar criteria of it.

With z ~ N(h(x, u, theta), Sigma_z), Eq. (6) becomes sum_k H_k^T Sigma_z^-1 H_k with H = dh/dtheta. Parameters are
scaled by their prior standard deviation first, or C_x (1e4 N) would swamp B, C and D.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from hil_gateway.process.arrays import Array, Expr


def stage_information(h: Expr, theta: Expr, std: Sequence[float], scale: Sequence[float]) -> Expr:
    """One term of Eq. (7) before the trace, symbolic: S H^T Sigma_z^-1 H S, shape (n_theta, n_theta).

    Args:
        h: measurement model, shape (m, 1), an expression in `theta`.
        theta: tyre parameters, shape (n_theta, 1).
        std: measurement standard deviations, length m (Sigma_z is diagonal).
        scale: prior standard deviation of each parameter, length n_theta.
    """
    weighted = ca.diag(1.0 / ca.DM(list(std))) @ ca.jacobian(h, theta) @ ca.diag(ca.DM(list(scale)))
    return weighted.T @ weighted


def fisher_information(jacobians: Array, std: Array, scale: Array) -> Array:
    """Eq. (7) before the trace for M samples, numeric: `jacobians` dh/dtheta (M, m, n) -> (n, n)."""
    weighted = (jacobians * scale / std[:, None]).reshape(-1, jacobians.shape[-1])
    return np.asarray(weighted.T @ weighted)


def trace_criterion(information: Array) -> float:
    """I = Tr(F), Eq. (7)."""
    return float(np.trace(information))


def d_criterion(information: Array) -> float:
    """log det F: minus twice the log volume of the confidence ellipsoid; -inf when F is singular."""
    sign, value = np.linalg.slogdet(information)
    return float(value) if sign > 0 else -np.inf


def a_criterion(information: Array) -> float:
    """Tr(F^-1): sum of the (scaled) parameter variances; inf when F is singular."""
    eigenvalues = np.linalg.eigvalsh(information)
    return float(np.sum(1.0 / eigenvalues)) if eigenvalues[0] > 0 else np.inf


def e_criterion(information: Array) -> float:
    """Smallest eigenvalue of F: information about the least known combination of parameters."""
    return float(np.linalg.eigvalsh(information)[0])
