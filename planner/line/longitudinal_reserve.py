"""What cornering leaves for braking and driving: each axle on a friction ellipse of its own, under its own load.

One ellipse for the whole car is exact only where both axles reach their limit together. A car whose front axle gives
way first has grip left at the rear to drive out of a bend, and braking puts load on the front axle; one whose rear axle
does has less of both (Gillespie, Fundamentals of Vehicle Dynamics, ch. 6).
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from hil_gateway.process.arrays import Array

SPEEDS = np.array([15.0, 30.0, 45.0, 60.0, 75.0])
"""m/s"""
SHARES = np.array([0.0, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.98, 0.995, 1.0])
"""of the largest lateral force in steady cornering"""
WITHIN = 1.0 - 1e-6
"""of a share: a car whose front axle sets the limit bears exactly that with many commands, whatever rounding says"""
Table = tuple[tuple[float, ...], ...]
"""share of the force along on a straight that is left, at `SPEEDS` (rows) and `SHARES` (columns)"""


def longitudinal_reserve(force: Array, lateral: Array, steady: Array) -> Table:
    """From what is borne with every command: largest force at a share of the lateral limit, over that at none.

    `force` (speeds, K): specific force along of K commands, rising from 0, as far as tyres bear them; `lateral`
    (speeds, K): what both axles then bear across; `steady` (speeds,): the lateral limit that shares are of.
    """
    rows = []
    for along, across, limit in zip(force, lateral, steady, strict=True):
        # the largest force is sought: an axle that gains load bears more across with some force than with none
        borne = np.maximum.accumulate(across[::-1])
        rows.append(np.interp(WITHIN * SHARES * limit, borne, along[::-1]) / max(float(along[-1]), 1e-9))
    return tuple(tuple(row.tolist()) for row in rows)


def interpolated(table: Any, speed: Any, share: Any) -> Any:
    """Value of a table (len(SPEEDS), len(SHARES)), flat by rows, as CasADi expressions; constant beyond its ends."""
    values = ca.reshape(table, len(SHARES), len(SPEEDS))
    return _along(ca.horzsplit(_along(ca.horzsplit(values), SPEEDS, speed).T), SHARES, share)


def _along(values: list[Any], grid: Array, x: Any) -> Any:
    """Piecewise linear through `values` at the points of `grid`."""
    steps = np.diff(grid)
    parts = [ca.fmin(ca.fmax((x - at) / step, 0.0), 1.0) for at, step in zip(grid[:-1], steps, strict=True)]
    rises = (part * (after - before) for part, before, after in zip(parts, values[:-1], values[1:], strict=True))
    return sum(rises, start=values[0])
