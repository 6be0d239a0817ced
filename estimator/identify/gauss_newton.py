"""Gauss-Newton with Levenberg's damping inside bounds, in coordinates in which the tyre curve's valley is straight.

Source: Nocedal & Wright, Numerical Optimization, ch. 10 and 16.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from estimator.identify.coordinates import StepCoordinates
from estimator.identify.problem import Problem

Array = NDArray[np.float64]

MOST_DAMPING = 1e9
"""Damping at which a step is as good as none: the iterations end."""

LONGEST_STEP = 2.0
"""Prior standard deviations a parameter moves at most in one step: farther, the linearisation says nothing."""


def minimise(problem: Problem, u: Array, decrease: float) -> tuple[Array, int, bool]:
    """Damped Gauss-Newton within the bounds: (estimate, iterations, whether the step fell below the tolerance)."""
    settings, damping, cost = problem.settings, 1e-6, problem.cost(u)
    coordinates = StepCoordinates(problem.table)
    box = coordinates.box(problem.lower, problem.upper)
    for iteration in range(settings.max_iterations):
        H, g = problem.normal_equations(u)
        if not (np.isfinite(H).all() and np.isfinite(g).all()):
            return u, iteration, False
        T, w = coordinates.tangent(u), coordinates.forward(u)
        while True:
            step = bounded_step(T.T @ H @ T, T.T @ g, w, box, damping)
            trial = _within_reach(problem, coordinates, u, w, step)
            length = math.sqrt(max(float((trial - u) @ H @ (trial - u)), 0.0))
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


def _within_reach(problem: Problem, coordinates: StepCoordinates, u: Array, w: Array, step: Array) -> Array:
    """u after the step, shortened to `LONGEST_STEP` and clipped to the bounds."""
    trial = np.clip(coordinates.inverse(w + step), problem.lower, problem.upper)
    longest = float(np.max(np.abs(trial - u)))
    if longest > LONGEST_STEP:
        trial = np.clip(coordinates.inverse(w + step * LONGEST_STEP / longest), problem.lower, problem.upper)
    return np.asarray(trial)


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
