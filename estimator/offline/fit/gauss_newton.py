"""Gauss-Newton with Levenberg's damping inside bounds, in coordinates in which the tyre curve's valley is straight.

Source: Nocedal & Wright, Numerical Optimization, ch. 10 and 16.
"""

from __future__ import annotations

import math

import numpy as np

from estimator.offline.fit.coordinates import LocalCoordinates
from estimator.offline.fit.problem import FitProblem
from hil_gateway.process.arrays import Array

MOST_DAMPING = 1e9
"""Damping at which a step is as good as none: the iterations end."""

LONGEST_STEP = 2.0
"""Prior standard deviations a parameter moves at most in one step: farther, the linearisation says nothing."""


def minimise(problem: FitProblem, u: Array, decrease: float) -> tuple[Array, int, bool]:
    """Damped Gauss-Newton within the bounds: (estimate, iterations, whether the step fell below the tolerance)."""
    settings, damping, cost = problem.settings, 1e-6, problem.cost(u)
    for iteration in range(settings.max_iterations):
        H, g = problem.normal_equations(u)
        if not (np.isfinite(H).all() and np.isfinite(g).all()):
            return u, iteration, False
        local = problem.coordinates.about(u)
        T, box = local.tangent(), local.box()
        H, g = T.T @ H @ T, T.T @ g
        while True:
            step = bounded_step(H, g, np.zeros_like(u), box, damping)
            trial, step = _within_reach(problem, local, step)
            length = math.sqrt(max(float(step @ H @ step), 0.0))
            trial_cost = problem.cost(trial)
            if trial_cost <= cost or length < settings.tolerance or damping > MOST_DAMPING:
                break
            damping = max(10.0 * damping, 1e-3)
        flat = not cost - trial_cost > decrease * cost
        if trial_cost <= cost:
            u, cost, damping = trial, trial_cost, max(0.03 * damping, 1e-9)
        if length < settings.tolerance or flat:
            return u, iteration + 1, True
    return u, settings.max_iterations, False


def _within_reach(problem: FitProblem, local: LocalCoordinates, step: Array) -> tuple[Array, Array]:
    """u after the step, clipped to the bounds, and the step, shortened so that u moves by `LONGEST_STEP` at most."""
    for _ in range(2):
        trial = np.clip(local.moved(step), problem.lower, problem.upper)
        longest = float(np.max(np.abs(trial - local.u)))
        if not longest > LONGEST_STEP:
            break
        step = step * LONGEST_STEP / longest
    return np.asarray(trial), step


def bounded_step(H: Array, g: Array, u: Array, box: tuple[Array, Array], damping: float) -> Array:
    """Newton step within `box` from u with Levenberg-Marquardt damping; what would leave its bounds stays on them."""
    lower, upper = box
    free = ~(((u <= lower) & (g > 0)) | ((u >= upper) & (g < 0)))
    step = np.zeros_like(u)
    for _ in range(len(u)):
        if not free.any():
            break
        part = H[np.ix_(free, free)]
        part = part + np.diag(damping * np.diag(part) + 1e-12 * (1.0 + np.trace(part)))
        step[free] = -np.linalg.solve(part, g[free] + H[np.ix_(free, ~free)] @ step[~free])
        leaving = free & ((u + step < lower) | (u + step > upper))
        if not leaving.any():
            break
        step[leaving] = np.clip(u + step, lower, upper)[leaving] - u[leaving]
        free &= ~leaving
    return np.asarray(np.clip(u + step, lower, upper) - u)
