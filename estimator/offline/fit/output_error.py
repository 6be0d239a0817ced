"""Output-error fit: vy and yaw rate simulated from steer and vx over windows, against what was measured.

Noise in the measured states never enters the slip angles, so nothing is biased by it, and no acceleration is
needed. The state at the start of each window is unknown and is eliminated from the normal equations (Schur
complement), so that the work grows linearly with the length of the log.
Source: Ljung, System Identification, 2nd ed., ch. 4.3 and 10; Bock (1983) for multiple windows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from estimator.drive_log.table import DriveLog
from estimator.model.columns import ModelColumns
from estimator.offline.fit.coordinates import LocalCoordinates
from estimator.offline.fit.equation_error import EquationErrorFit, solve
from estimator.offline.fit.problem import (
    AlgebraicProblem,
    FitProblem,
    FitSettings,
    block_length,
    huber_loss,
    huber_weight,
    typical_slips,
)
from estimator.offline.predict.simulate import OUTPUTS, STATES, SimulatedStates, Simulator
from estimator.offline.record.prepare import Samples
from estimator.offline.record.windows import STATE_ROWS, cut
from hil_gateway.process.arrays import Array

WINDOW_S = 4.0

SHORTEST_WINDOW_S = 1.0
DIVERGING = 2.0
"""Root mean square over robust spread of a simulated output from which windows are shortened."""

MAX_ITERATIONS = 15
"""Of each round: a good start needs five, and a log on which a simulation diverges does not get better by more."""


@dataclass(frozen=True)
class _Starts:
    """Start states (2, L) that fit best near u: `best` - `gain` (L, 2, p) w(u), from the last linearisation."""

    at: LocalCoordinates
    best: Array
    gain: Array

    def near(self, u: Array) -> Array:
        return np.asarray(self.best - (self.gain @ self.at.displacement(u)).T)


@dataclass(frozen=True)
class OutputErrorSettings:
    """`outputs` simulated and compared; `longitudinal` the algebraic channels that determine C_x."""

    fit: FitSettings = field(default_factory=lambda: FitSettings(max_iterations=MAX_ITERATIONS))
    window_s: float = WINDOW_S
    outputs: tuple[str, ...] = ("vy", "yaw_rate")
    longitudinal: tuple[str, ...] = ("ax",)


class OutputErrorProblem(FitProblem):
    """Residuals of simulated windows, plus the algebraic longitudinal channel."""

    def __init__(
        self,
        columns: ModelColumns,
        log: DriveLog,
        samples: Samples,
        settings: OutputErrorSettings,
        simulating: Callable[[], None] = lambda: None,
    ) -> None:
        """Cut `samples` into windows; the longitudinal channel uses a quarter of the rows at most 25 Hz.

        `simulating` is called before every simulation.
        """
        self.simulating = simulating
        self.outputs = tuple(o for o in OUTPUTS if o in settings.outputs)
        thinned = samples.thin(max(1, round(0.04 / samples.step)))
        self.algebraic = AlgebraicProblem(
            columns, thinned, replace(settings.fit, channels=settings.longitudinal, prior=False)
        )
        super().__init__(columns.parameters, settings.fit, typical_slips(samples, columns.model.vehicle))
        self.windows = cut(log, samples, settings.window_s)
        self.simulator = Simulator(columns)
        rows = [OUTPUTS.index(o) for o in self.outputs]
        self.measured = self.windows.measured[rows]
        self.rows = rows
        self.starts = self.measured_starts()

    def measured_starts(self) -> _Starts:
        """Start states as measured, wherever u is."""
        measured = self.windows.inputs[list(STATE_ROWS), 0]
        return _Starts(
            self.coordinates.about(np.zeros(self.size)), measured, np.zeros((self.windows.count, STATES, self.size))
        )

    @property
    def channels(self) -> tuple[str, ...]:
        return (*self.outputs, *self.algebraic.channels)

    def simulate(self, u: Array, sensitivities: bool = True) -> SimulatedStates:
        """Windows simulated at u from the start states that fit best there."""
        self.simulating()
        return self.simulator.run(self.windows, self.starts.near(u), self.theta(u), sensitivities)

    def errors(self, trajectory: SimulatedStates) -> Array:
        """(o, K, L) measured minus simulated; padding is zero."""
        return np.asarray((self.measured - trajectory.outputs[self.rows]) * self.windows.weight)

    def _weighted(self, trajectory: SimulatedStates) -> tuple[Array, Array, Array]:
        """Residuals (o, K, L), their Jacobians by u (o, p, K, L) and by start (o, 2, K, L), all times sqrt(weight)."""
        assert trajectory.by_theta is not None
        assert trajectory.by_start is not None
        spread = self.spread[: len(self.outputs), None, None]
        z = np.nan_to_num(self.errors(trajectory) / spread, nan=1e3, posinf=1e3, neginf=-1e3)
        root = np.sqrt(huber_weight(z, self.settings.huber)) * self.windows.weight
        by = root[:, None] / spread[:, None]
        J = np.nan_to_num(trajectory.by_theta[self.rows] * self.scale[:, None, None] * by)
        J0 = np.nan_to_num(trajectory.by_start[self.rows] * by)
        return z * root, J, J0

    def cost(self, u: Array) -> float:
        losses = self._losses(self.simulate(u, sensitivities=False))
        if not np.isfinite(losses).all():
            return np.inf
        self._pass_spread()
        return float(losses.sum()) + self.algebraic.cost(u) + self.prior_cost(u)

    def _losses(self, trajectory: SimulatedStates) -> Array:
        """(L,) robust loss of each window."""
        z = self.errors(trajectory) / self.spread[: len(self.outputs), None, None]
        return np.asarray(huber_loss(z, self.settings.huber).sum(axis=(0, 1)))

    def _better_starts(self, u: Array, shift: Array, here: SimulatedStates) -> Array:
        """Start states moved by `shift` (2, L) in the windows that gain by it: those of an unstable car may not."""
        start = self.starts.near(u)
        moved = self.simulator.run(self.windows, start + shift, self.theta(u), sensitivities=False)
        return np.asarray(start + shift * (self._losses(moved) <= self._losses(here)))

    def normal_equations(self, u: Array) -> tuple[Array, Array]:
        self._pass_spread()
        H, g = self.algebraic.normal_equations(u)
        information, scores = self._reduced(u, self.windows.weight.shape[0])
        return H + information + self.precision, g - scores.sum(axis=1) + self.precision @ u

    def _reduced(self, u: Array, each_samples: int) -> tuple[Array, Array]:
        """Information (p, p), and scores (p, m) of stretches of so many samples, with the start states eliminated.

        The start states are moved on.
        """
        trajectory = self.simulate(u)
        z, J, J0 = self._weighted(trajectory)
        H = np.einsum("opkl,oqkl->lpq", J, J, optimize=True)
        cross = np.einsum("opkl,oakl->lpa", J, J0, optimize=True)
        H00 = np.einsum("oakl,obkl->lab", J0, J0, optimize=True)
        g0 = np.einsum("oakl,okl->la", J0, z)
        gain = _solve_each(H00, cross.swapaxes(1, 2)).swapaxes(1, 2)
        shift = _solve_each(H00, g0[..., None])[..., 0].T
        local = self.coordinates.about(u)
        gain_w = gain.swapaxes(1, 2) @ local.tangent()
        self.starts = _Starts(local, self._better_starts(u, shift, trajectory), gain_w)
        information = (H - gain @ cross.swapaxes(1, 2)).sum(axis=0)
        starts = np.arange(0, z.shape[1], each_samples)
        by_theta, by_start = (_summed(each, z, starts) for each in (J, J0))
        scores = by_theta - np.einsum("lpa,aml->pml", gain, by_start)
        return information, scores[:, self.windows.weight[starts] > 0.0]

    def information_and_scatter(self, u: Array) -> tuple[Array, Array, int]:
        self._pass_spread()
        H, scatter, _ = self.algebraic.information_and_scatter(u)
        step = self.windows.step
        length = block_length(
            self, float(self.windows.weight.sum()) * step, self.algebraic.columns.model.vehicle.own_time
        )
        information, scores = self._reduced(u, max(1, round(length / step)))
        return H + information, scatter + scores @ scores.T, scores.shape[1]

    def robust_spread(self, u: Array) -> Array:
        errors = np.abs(self.errors(self.simulate(u, sensitivities=False)))
        used = self.windows.weight > 0
        typical = np.array([1.4826 * np.median(np.nan_to_num(e[used], nan=np.inf)) for e in errors])
        return np.concatenate([np.maximum(typical, 1e-9), self.algebraic.robust_spread(u)])

    def residual_rms(self, u: Array) -> Array:
        errors = self.errors(self.simulate(u, sensitivities=False))
        mean_square = (errors**2).sum(axis=(1, 2)) / self.windows.weight.sum()
        return np.concatenate([np.sqrt(mean_square), self.algebraic.residual_rms(u)])

    def _pass_spread(self) -> None:
        self.algebraic.spread = self.spread[len(self.outputs) :]


def _summed(J: Array, z: Array, starts: NDArray[np.int64]) -> Array:
    """(n, m, L) products of (o, n, K, L) J and (o, K, L) z, summed over outputs and from each of `starts` on."""
    return np.asarray(np.add.reduceat(np.einsum("onkl,okl->nkl", J, z, optimize=True), starts, axis=1))


def fit_output_error(  # noqa: PLR0917 - what is fitted to what, and who is told
    columns: ModelColumns,
    log: DriveLog,
    samples: Samples,
    settings: OutputErrorSettings,
    starts: Sequence[Array],
    simulating: Callable[[], None] = lambda: None,
) -> EquationErrorFit:
    """Estimate the parameters, beginning at the best of `starts` (p,), SI: the prior, or what the algebraic fit says.

    A simulation has local optima that an algebraic fit to noisy states can fall into. Windows that run away from the
    data are shortened. `simulating` is called before every simulation.
    """
    problem = OutputErrorProblem(columns, log, samples, settings, simulating)
    spreads = [problem.robust_spread(problem.scaled(start)) for start in starts]
    best = int(np.argmin([np.sum(np.log(spread)) for spread in spreads]))
    result = solve(problem, starts[best])
    if _diverges(problem, result) and settings.window_s > SHORTEST_WINDOW_S:
        shorter = replace(settings, window_s=max(0.25 * settings.window_s, SHORTEST_WINDOW_S))
        return fit_output_error(columns, log, samples, shorter, starts, simulating)
    return result


def _diverges(problem: OutputErrorProblem, result: EquationErrorFit) -> bool:
    """Whether some windows diverge: beyond its limit a car is unstable and cannot be simulated for long."""
    return any(result.rmse[o] > DIVERGING * result.spread[o] for o in problem.outputs)


def _solve_each(H: Array, right: Array) -> Array:
    """Solve the (L, 2, 2) systems for (L, 2, m), damped so that windows without information stay solvable."""
    damped = H + 1e-9 * np.eye(STATES) * (1.0 + np.trace(H, axis1=1, axis2=2))[:, None, None]
    return np.asarray(np.linalg.solve(damped, right))
