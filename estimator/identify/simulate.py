"""Open-loop simulation of vy and yaw rate over many windows at once, with sensitivities.

vx, steer, drive and the auxiliary signals are inputs. States are integrated by RK4; the sensitivities to the
parameters and to the initial state follow the linearised dynamics along the trajectory, discretised to second order.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from estimator.identify.evaluate import CHANNELS, Columns, ModelColumns
from estimator.identify.nuisance import VY_SENSOR, YAW_RATE_TIMING, reported_vy
from estimator.identify.windows import STATE_ROWS, Windows
from estimator.model.single_track import SIGNALS

Array = NDArray[np.float64]

STATES = 2
OUTPUTS = ("vy", "yaw_rate", "ay", "yaw_acc")
"""What is simulated: vy as its sensor reports it, yaw rate, specific force, yaw acceleration."""


@dataclass(frozen=True)
class Trajectory:
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
        self._rates = Columns(ca.Function("rates", [inputs, theta], [ca.densify(rates)], {"cse": True}))
        self._outputs = Columns(ca.Function("outputs", [inputs, theta], [ca.densify(outputs)], {"cse": True}))
        out = ca.densify(ca.vertcat(outputs, ca.vec(jacobian.T)))
        self._linear = Columns(ca.Function("linear", [inputs, theta], [out], {"cse": True}))

    def run(self, windows: Windows, start: Array, theta: Array, sensitivities: bool = True) -> Trajectory:
        """Simulate from `start` (2, L) at parameters `theta` (p,)."""
        states = self._integrate(windows, start, theta)
        inputs = windows.inputs.copy()
        inputs[list(STATE_ROWS)] = states
        k, grid, lanes = inputs.shape
        sampled = slice(None, None, windows.substeps)
        if not sensitivities:
            coarse = inputs[:, sampled]
            return Trajectory(self._outputs(coarse.reshape(k, -1), theta).reshape(len(OUTPUTS), -1, lanes))
        values = self._linear(inputs.reshape(k, -1), theta).reshape(-1, grid, lanes)
        J = values[len(OUTPUTS) :].reshape(STATES + len(OUTPUTS), STATES + self.parameters, grid, lanes)
        S = _propagate(J[:STATES], windows.grid_step)[:, :, sampled]
        full = np.einsum("oxkl,xpkl->opkl", J[STATES:, :STATES, sampled], S)
        full[:, STATES:] += J[STATES:, STATES:, sampled]
        return Trajectory(values[: len(OUTPUTS), sampled], by_theta=full[:, STATES:], by_start=full[:, :STATES])

    def _integrate(self, windows: Windows, start: Array, theta: Array) -> Array:
        """(2, G, L) states on the integration grid, RK4; diverging lanes end as nan."""
        h, inputs = windows.grid_step, windows.inputs
        states = np.empty((STATES, *inputs.shape[1:]))
        states[:, 0] = s = start

        def f(signals: Array, state: Array) -> Array:
            signals[list(STATE_ROWS)] = state
            return self._rates(signals, theta)

        with np.errstate(over="ignore", invalid="ignore"):
            for g in range(inputs.shape[1] - 1):
                here, there = inputs[:, g].copy(), inputs[:, g + 1].copy()
                middle = 0.5 * (here + there)
                k1 = f(here, s)
                k2 = f(middle, s + 0.5 * h * k1)
                k3 = f(middle, s + 0.5 * h * k2)
                k4 = f(there, s + h * k3)
                states[:, g + 1] = s = s + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        return states


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
    """(2, 2 + p, G, L) d state / d (start, theta) from the Jacobian J = [df/ds, df/dtheta] of the same shape."""
    grid = J.shape[2]
    middle = 0.5 * (J[:, :, :-1] + J[:, :, 1:])
    A, B = middle[:, :STATES], middle[:, STATES:]
    AA = np.einsum("xykl,yzkl->xzkl", A, A)
    phi = np.eye(STATES)[:, :, None, None] + h * A + 0.5 * h * h * AA
    gamma = h * B + 0.5 * h * h * np.einsum("xykl,ypkl->xpkl", A, B)
    S = np.zeros_like(J)
    S[0, 0, 0], S[1, 1, 0] = 1.0, 1.0
    for g in range(grid - 1):
        S[:, :, g + 1] = np.einsum("xyl,ypl->xpl", phi[:, :, g], S[:, :, g])
        S[:, STATES:, g + 1] += gamma[:, :, g]
    return S
