"""Open-loop simulation of vy and yaw rate over many windows at once, with sensitivities.

vx, steer, drive and the auxiliary signals are inputs. States are integrated by ROS2, a linearly implicit method of
second order that is L-stable, since a slow car's lateral dynamics are faster than any log's sampling. Sensitivities
to the parameters and to the initial state follow the linearised dynamics by the same method.
Source: Verwer, Spee, Blom, Hundsdorfer, SIAM J. Sci. Comput. 20 (1999), eq. 2.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from estimator.model.columns import CHANNELS, Columns, ModelColumns
from estimator.model.effect import VY_SENSOR
from estimator.model.single_track import SIGNALS
from estimator.offline.predict.nuisance import YAW_RATE_TIMING, reported_vy
from estimator.offline.record.windows import STATE_ROWS, Windows
from hil_gateway.process.arrays import Array

GAMMA = 1.0 - 0.5**0.5
"""Coefficient of ROS2 that makes it L-stable with the smaller error."""

STATES = len(STATE_ROWS)
OUTPUTS = ("vy", "yaw_rate", "ay", "yaw_acc")
"""What is simulated: vy as its sensor reports it, yaw rate, specific force, yaw acceleration."""


@dataclass(frozen=True)
class SimulatedStates:
    """Simulated `OUTPUTS` (4, K, L), with their derivatives where asked for.

    `by_theta` (4, p, K, L) and `by_start` (4, 2, K, L) belong to the parameters and the state at the window's start.
    """

    outputs: Array
    by_theta: Array | None = None
    by_start: Array | None = None


class Simulator:
    """Simulates one model; functions are built once."""

    def __init__(self, columns: ModelColumns) -> None:
        """Build the dynamics (vy_dot, yaw_acc) and the outputs of `columns.model`."""
        inputs, theta, channels = columns.expressions
        self.parameters = len(columns.parameters)
        rates = ca.vertcat(channels[CHANNELS.index("vy_dot")], channels[CHANNELS.index("yaw_acc")])
        outputs = _outputs(columns)
        everything = ca.vertcat(rates, outputs)
        state = ca.vertcat(*(inputs[i] for i in STATE_ROWS))
        jacobian = ca.horzcat(ca.jacobian(everything, state), ca.jacobian(everything, theta))
        slope = ca.densify(ca.vertcat(rates, ca.vec(ca.jacobian(rates, state).T)))
        self._rates_and_slope = Columns(ca.Function("slope", [inputs, theta], [slope], {"cse": True}))
        self._rates = Columns(ca.Function("rates", [inputs, theta], [ca.densify(rates)], {"cse": True}))
        self._outputs = Columns(ca.Function("outputs", [inputs, theta], [ca.densify(outputs)], {"cse": True}))
        out = ca.densify(ca.vertcat(outputs, ca.vec(jacobian.T)))
        self._linear = Columns(ca.Function("linear", [inputs, theta], [out], {"cse": True}))

    def run(self, windows: Windows, start: Array, theta: Array, sensitivities: bool = True) -> SimulatedStates:
        """Simulate from `start` (2, L) at parameters `theta` (p,)."""
        states = self._integrate(windows, start, theta)
        inputs = windows.inputs.copy()
        inputs[list(STATE_ROWS)] = states
        k, size, lanes = inputs.shape
        if not sensitivities:
            return SimulatedStates(self._outputs(inputs.reshape(k, -1), theta).reshape(len(OUTPUTS), size, lanes))
        values = self._linear(inputs.reshape(k, -1), theta).reshape(-1, size, lanes)
        J = values[len(OUTPUTS) :].reshape(STATES + len(OUTPUTS), STATES + self.parameters, size, lanes)
        S = _propagate(J[:STATES], windows.step)
        full = np.einsum("oxkl,xpkl->opkl", J[STATES:, :STATES], S)
        full[:, STATES:] += J[STATES:, STATES:]
        return SimulatedStates(values[: len(OUTPUTS)], by_theta=full[:, STATES:], by_start=full[:, :STATES])

    def _integrate(self, windows: Windows, start: Array, theta: Array) -> Array:
        """(2, K, L) states by ROS2 with inputs at the middle of each step; diverging lanes end as nan."""
        h, inputs = windows.step, windows.inputs
        states = np.empty((STATES, *inputs.shape[1:]))
        states[:, 0] = s = start
        rows = list(STATE_ROWS)
        with np.errstate(all="ignore"):
            for k in range(inputs.shape[1] - 1):
                signals = 0.5 * (inputs[:, k] + inputs[:, k + 1])
                signals[rows] = s
                values = self._rates_and_slope(signals, theta)
                W = _inverse_2x2(_identity_minus(GAMMA * h, values[STATES:].reshape(STATES, STATES, -1)))
                k1 = _apply(W, values[:STATES])
                signals[rows] = s + h * k1
                k2 = _apply(W, self._rates(signals, theta) - 2.0 * k1)
                states[:, k + 1] = s = s + 1.5 * h * k1 + 0.5 * h * k2
        return states


def _identity_minus(factor: float, A: Array) -> Array:
    """I - factor A for (2, 2, L) A."""
    result = -factor * A
    result[0, 0] += 1.0
    result[1, 1] += 1.0
    return np.asarray(result)


def _inverse_2x2(A: Array) -> Array:
    """Inverse of each of (2, 2, ...) matrices."""
    return np.asarray(np.stack([np.stack([A[1, 1], -A[0, 1]]), np.stack([-A[1, 0], A[0, 0]])])
                      / (A[0, 0] * A[1, 1] - A[0, 1] * A[1, 0]))  # fmt: skip


def _apply(A: Array, x: Array) -> Array:
    """A x for (2, 2, L) A and (2, L) x."""
    return np.asarray(A[:, 0] * x[0] + A[:, 1] * x[1])


def _outputs(columns: ModelColumns) -> Any:
    inputs, theta, channels = columns.expressions
    vx, (vy, yaw_rate) = inputs[SIGNALS.index("vx")], (inputs[i] for i in STATE_ROWS)
    ay, yaw_acc = (channels[CHANNELS.index(name)] for name in ("ay", "yaw_acc"))
    sensor, timing = (_values_of(name, columns, theta) for name in (VY_SENSOR, YAW_RATE_TIMING))
    vy_out = reported_vy(vx, vy, yaw_rate, sensor) if sensor else vy
    yaw_rate_out = yaw_rate - timing[0] * yaw_acc if timing else yaw_rate
    return ca.vertcat(vy_out, yaw_rate_out, ay, yaw_acc)


def _values_of(effect: str, columns: ModelColumns, theta: Any) -> list[Any]:
    """Symbols of the parameters of one effect; empty where the model does not carry it."""
    return [theta[i] for i, p in enumerate(columns.parameters) if p.name.startswith(f"{effect}.")]


def _propagate(J: Array, h: float) -> Array:
    """(2, 2 + p, K, L) d state / d (start, theta) from the Jacobian J = [df/ds, df/dtheta] of the same shape.

    Each step is that of ROS2 for the linearised dynamics: R(hA) = W^-2 (I + (1 - 2 gamma) hA) with W = I - gamma hA,
    and h W^-2 (I - gamma^2 hA) B for what the parameters drive.
    """
    middle = 0.5 * (J[:, :, :-1] + J[:, :, 1:])
    A, B = h * middle[:, :STATES], h * middle[:, STATES:]
    W = _inverse_2x2(_identity_minus(GAMMA, A))
    WW = np.einsum("xykl,yzkl->xzkl", W, W)
    phi = np.einsum("xykl,yzkl->xzkl", WW, _identity_minus(2.0 * GAMMA - 1.0, A))
    drive = np.einsum("xykl,ypkl->xpkl", np.einsum("xykl,yzkl->xzkl", WW, _identity_minus(GAMMA**2, A)), B)
    S = np.zeros_like(J)
    S[0, 0, 0], S[1, 1, 0] = 1.0, 1.0
    for k in range(J.shape[2] - 1):
        here = S[:, :, k]
        S[:, :, k + 1] = phi[:, :1, k] * here[0] + phi[:, 1:, k] * here[1]
        S[:, STATES:, k + 1] += drive[:, :, k]
    return S
