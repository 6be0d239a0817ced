"""Coordinates in which steps are taken and errors are normal: the tyre curve at three slips instead of B, C, D.

What data determine of an axle is its lateral force at the slips they hold. In B, C, D the sum of squares is a long
curved valley along which Gauss-Newton crawls, and along which a covariance says little; in the forces at three slips
it is straight. Where an axle's parameters are near a bound, which is one of B, C or D, or the slips too small to tell
the three forces apart, the coordinates are log(B C D), C and log D. The estimate itself is unchanged.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from estimator.model.parameters import Parameter
from estimator.model.tyre import AXLES, force_derivatives, normalised_force
from hil_gateway.process.arrays import Array

NEAR_BOUND = 0.01
"""share of a parameter's range"""

SUBSTEPS = 12
"""of the Runge-Kutta integration that leads B, C, D along a straight line of forces"""

WORST_CONDITION = 1e7
"""of the forces' derivatives by log B, log C and log D"""

Axle = tuple[int, int, int]


class StepCoordinates:
    """Finds the axles' (B, C, D) in a parameter table and gives the coordinates about a point."""

    def __init__(self, table: Sequence[Parameter], slips: Mapping[str, Array]) -> None:
        """`slips`: three slip angles (3,), rad, for each suffix ("", "f", "r") of b, c, d in `table`."""
        names = [p.name for p in table]
        self.prior = np.array([p.prior for p in table])
        self.scale = np.array([p.prior_std for p in table])
        self.lower, self.upper = np.array([p.lower for p in table]), np.array([p.upper for p in table])
        self.axles: list[tuple[Axle, Array]] = []
        for axle in (axle for layout in AXLES.values() for axle in layout):
            if set(axle.parameters) <= set(names):
                self.axles.append((axle.rows(names), slips[axle.suffix]))

    def about(self, u: Array) -> LocalCoordinates:
        """Coordinates that are 0 at u (p,), scaled parameters (theta - prior) / prior_std."""
        theta = self.prior + self.scale * u
        curves: list[Curve] = []
        for indices, slips in self.axles:
            rows = list(indices)
            room = np.minimum(theta[rows] - self.lower[rows], self.upper[rows] - theta[rows])
            inside = bool((room > NEAR_BOUND * (self.upper - self.lower)[rows]).all())
            forces = ForceCoordinates(indices, slips)
            curves.append(forces if inside and forces.well_conditioned(theta[rows]) else StiffnessCoordinates(indices))
        return LocalCoordinates(self, u, theta, tuple(curves))


@dataclass(frozen=True)
class ForceCoordinates:
    """Force over load and D-like peak at three slips as coordinates of one axle."""

    indices: Axle
    slips: Array

    def well_conditioned(self, theta: Array) -> bool:
        """Whether (B, C, D) follow from the three forces."""
        return bool(np.linalg.cond(self.derivative(theta) * theta) < WORST_CONDITION)

    def value(self, theta: Array) -> Array:
        """Coordinates (..., 3) of (..., 3) B, C, D: Eq. (2) over the load."""
        B, C, D = (theta[..., i, None] for i in range(3))
        return np.asarray(normalised_force(self.slips, B, C, D))

    def derivative(self, theta: Array) -> Array:
        """(..., 3, 3) derivatives of the coordinates by B, C, D."""
        B, C, D = (theta[..., i, None] for i in range(3))
        return force_derivatives(self.slips, B, C, D)

    def moved(self, theta: Array, change: Array) -> Array:
        """B, C, D (..., 3) after a `change` (..., 3) of the coordinates, along the straight line there."""
        h = 1.0 / SUBSTEPS

        def rate(at: Array) -> Array:
            regular = self.derivative(at) + 1e-12 * np.eye(3)
            return np.asarray(np.linalg.solve(regular, change[..., None])[..., 0])

        at = np.broadcast_to(theta, change.shape)
        for _ in range(SUBSTEPS):
            k1 = rate(at)
            k2 = rate(at + 0.5 * h * k1)
            k3 = rate(at + 0.5 * h * k2)
            at = at + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + rate(at + h * k3))
        return at

    def box(self, theta: Array, lower: Array, upper: Array) -> tuple[Array, Array]:
        """Bounds of the change: none, those of B, C, D are kept by clipping."""
        return np.full(3, -np.inf), np.full(3, np.inf)


@dataclass(frozen=True)
class StiffnessCoordinates:
    """log(B C D), C and log D as coordinates of one axle."""

    indices: Axle

    def value(self, theta: Array) -> Array:
        """Coordinates (..., 3) of (..., 3) B, C, D."""
        product = np.log(theta).sum(axis=-1)
        return np.stack([product, theta[..., 1], np.log(theta[..., 2])], axis=-1)

    def derivative(self, theta: Array) -> Array:
        """(3, 3) derivatives of the coordinates by B, C, D."""
        B, C, D = theta
        return np.array([[1.0 / B, 1.0 / C, 1.0 / D], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0 / D]])

    def moved(self, theta: Array, change: Array) -> Array:
        """B, C, D (..., 3) after a `change` (..., 3) of the coordinates."""
        product, C, log_d = np.moveaxis(self.value(theta) + change, -1, 0)
        D = np.exp(log_d)
        return np.stack([np.exp(product) / (C * D), C, D], axis=-1)

    def box(self, theta: Array, lower: Array, upper: Array) -> tuple[Array, Array]:
        """Bounds of the change; those of B are kept by clipping."""
        low, high = (np.array([0.0, bound[1] - theta[1], np.log(bound[2] / theta[2])]) for bound in (lower, upper))
        low[0], high[0] = -np.inf, np.inf
        return low, high


Curve = ForceCoordinates | StiffnessCoordinates


@dataclass(frozen=True)
class LocalCoordinates:
    """w (p,) about a point: the change of u, but for each axle's B, C and D that of its `curves` coordinates."""

    owner: StepCoordinates
    u: Array
    theta: Array
    curves: tuple[Curve, ...]

    def tangent(self) -> Array:
        """du/dw (p, p) at the point."""
        T = np.eye(len(self.u))
        for curve in self.curves:
            rows = list(curve.indices)
            T[np.ix_(rows, rows)] = np.linalg.inv(curve.derivative(self.theta[rows])) / self.owner.scale[rows][:, None]
        return T

    def moved(self, w: Array) -> Array:
        """u (..., p) at w (..., p)."""
        u = self.u + w
        for curve in self.curves:
            rows = list(curve.indices)
            theta = curve.moved(self.theta[rows], w[..., rows])
            u[..., rows] = (theta - self.owner.prior[rows]) / self.owner.scale[rows]
        return np.asarray(u)

    def displacement(self, u: Array) -> Array:
        """w (p,) of u (p,)."""
        w, theta = u - self.u, self.owner.prior + self.owner.scale * u
        for curve in self.curves:
            rows = list(curve.indices)
            w[rows] = curve.value(theta[rows]) - curve.value(self.theta[rows])
        return np.asarray(w)

    def box(self) -> tuple[Array, Array]:
        """Bounds of w (p,)."""
        owner = self.owner
        low, high = ((bound - owner.prior) / owner.scale - self.u for bound in (owner.lower, owner.upper))
        for curve in self.curves:
            rows = list(curve.indices)
            low[rows], high[rows] = curve.box(self.theta[rows], owner.lower[rows], owner.upper[rows])
        return low, high
