"""The scalar Kalman update that all filters share, as CasADi expressions."""

from __future__ import annotations

import casadi as ca

from hil_gateway.process.arrays import Expr


def scalar_update(P: Expr, H: Expr, variance: Expr) -> tuple[Expr, Expr]:
    """Gain K (n, 1) and covariance (n, n) after a measurement with row `H` (1, n) of the state and `variance`.

    Joseph form, (I - K H) P (I - K H)' + K variance K', so that the covariance stays positive semi-definite whatever
    the rounding; I - K H is applied as the rank-one change it is.
    """
    PH = P @ H.T
    K = PH / (H @ PH + variance)
    after = P - K @ PH.T
    after = after - (after @ H.T) @ K.T + variance * (K @ K.T)
    return K, symmetric(after)


def symmetric(matrix: Expr) -> Expr:
    """The upper triangle twice: what is equal is computed once."""
    return ca.triu2symm(ca.triu(matrix))
