"""Continuous-time motion of the car, Eq. (1), and its integration over one sample."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import casadi as ca

from estimator.model.single_track import SingleTrack, Terms
from hil_gateway.process.arrays import Expr

STATES = ("x", "y", "yaw", "vx", "vy", "yaw_rate")
"""Vehicle part of the paper's state vector; progress s is appended by the planner."""


def state_derivative(
    model: SingleTrack,
    state: Sequence[Expr],
    control: Sequence[Expr],
    theta: Sequence[Expr],
    phi: Sequence[Expr] = (),
    *,
    aux: Mapping[str, Expr] | None = None,
) -> Expr:
    """Eq. (1): d/dt [X, Y, yaw, vx, vy, yaw_rate] for control steer, drive; SI, shape (6, 1).

    `aux` holds what active effects need.
    """
    _, _, yaw, vx, vy, yaw_rate = state
    steer, drive = control
    signals = {"yaw": yaw, **(aux or {})}
    terms = model.evaluate(Terms(model.vehicle, vx, vy, yaw_rate, steer, drive, aux=signals), theta, phi)
    return ca.vertcat(
        vx * ca.cos(yaw) - vy * ca.sin(yaw),
        vx * ca.sin(yaw) + vy * ca.cos(yaw),
        yaw_rate,
        terms.vx_dot,
        terms.vy_dot,
        terms.yaw_acc,
    )


def rk4(derivative: Callable[[Expr], Expr], state: Expr, dt: Expr, steps: int = 1) -> Expr:
    """Classical Runge-Kutta of order 4 with the input held, `steps` equal sub-steps of `dt`."""
    h = dt / steps
    for _ in range(steps):
        k1 = derivative(state)
        k2 = derivative(state + h / 2 * k1)
        k3 = derivative(state + h / 2 * k2)
        k4 = derivative(state + h * k3)
        state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return state
