"""The tyre model: its curve, Eq. (2), its peak and derivatives; its parameters' names; slip angles, Eq. (3).

Whoever needs the curve or the names of its parameters takes them from here; values and bounds are in `parameters`.
Arguments may be numbers, numpy arrays or CasADi expressions.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from estimator.model.parameters import Layout
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.process.arrays import Array, Expr

CURVE = ("b", "c", "d")
"""Letters of an axle's parameters in the order in which every function here takes them: B, C, D."""

COMPLEX_STEP = 1e-30
"""Imaginary step of the derivatives: no difference is taken, so a tiny one costs no digits (Squire & Trapp 1998)."""

KINEMATIC_BLEND_RATE = 0.67
"""Wheelbases per second below which slip angles fade to zero instead of diverging: 2 m/s for the AV-24, and in
proportion for a model car."""


@dataclass(frozen=True)
class TyreAxle:
    """Which parameters make the curve of an axle; `suffix` "f", "r", or "" for one curve on both axles."""

    name: str
    suffix: str

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of B, C and D."""
        return tuple(letter + self.suffix for letter in CURVE)

    def of(self, values: Mapping[str, Expr]) -> tuple[Expr, ...]:
        """(B, C, D) among named values."""
        return tuple(values[name] for name in self.parameters)

    def rows(self, names: Sequence[str]) -> tuple[int, int, int]:
        """Positions of B, C and D in a list of names."""
        b, c, d = (names.index(name) for name in self.parameters)
        return b, c, d


AXLES: Mapping[Layout, tuple[TyreAxle, ...]] = {
    "shared": (TyreAxle("both axles", ""),),
    "per_axle": (TyreAxle("front", "f"), TyreAxle("rear", "r")),
}
"""Curves of a layout."""


def front_and_rear(layout: Layout) -> tuple[TyreAxle, TyreAxle]:
    """Parameters of the front and of the rear axle; the same ones twice where they share a curve."""
    return AXLES[layout][0], AXLES[layout][-1]


def load_rows(names: Sequence[str], layout: Layout) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Positions in theta of what the force of the front and of the (driven) rear axle depends on."""
    front, rear = front_and_rear(layout)
    return front.rows(names), (names.index("cx"), *rear.rows(names))


def normalised_force(slip: Expr, B: Expr, C: Expr, D: Expr) -> Expr:
    """Eq. (2) over the axle load: D sin(C atan(B alpha))."""
    numeric = any(isinstance(value, np.ndarray) for value in (slip, B, C, D))
    sin, atan = (np.sin, np.arctan) if numeric else (ca.sin, ca.atan)
    return D * sin(C * atan(B * slip))


def force_derivatives(slip: Array, B: Array, C: Array, D: Array) -> Array:
    """(..., 3) derivatives of `normalised_force` by B, C and D, by a complex step: exact to rounding."""
    step, values = 1j * COMPLEX_STEP, (np.asarray(B), np.asarray(C), np.asarray(D))
    moved = [[v + step if i == k else v for i, v in enumerate(values)] for k in range(len(values))]
    return np.stack([np.imag(normalised_force(slip, *point)) / COMPLEX_STEP for point in moved], axis=-1)


def slip_at_peak(B: float, C: float) -> float:
    """Slip angle of the largest force, rad: C atan(B alpha) = pi / 2; pi / 2 where C <= 1, whose force only grows."""
    return math.tan(math.pi / (2.0 * C)) / B if C > 1.0 else math.pi / 2


def lateral_force(slip: Expr, load: Expr, B: Expr, C: Expr, D: Expr) -> Expr:
    """Eq. (2): F_y = D F_z sin(C atan(B alpha)), N; D is normalised by the axle load F_z."""
    return load * normalised_force(slip, B, C, D)


def peak_force(load: Expr, B: Expr, C: Expr, D: Expr) -> Expr:
    """Largest |F_y| of `lateral_force`, N."""
    return D * load


def with_grip(factor: Expr, B: Expr, C: Expr, D: Expr) -> tuple[Expr, Expr, Expr]:
    """(B, C, D) of the same tyre on a road that gives `factor` times the force."""
    return B, C, D * factor


def longitudinal_force(drive: Expr, C_x: Expr) -> Expr:
    """Eq. (2): F_x = C_x d, N, with d the slip-ratio command."""
    return C_x * drive


def blend_speed(vehicle: Vehicle) -> float:
    """Speed, m/s, below which `safe_speed` departs from vx."""
    return KINEMATIC_BLEND_RATE * vehicle.wheelbase


def safe_speed(vx: Expr, blend: float) -> Expr:
    """Smooth positive denominator for slip: |vx| to 0.02 % above 6 `blend`, never below `blend`."""
    return ca.sqrt(ca.sqrt(vx * vx * vx * vx + blend**4))


def slip_front(vx: Expr, vy: Expr, yaw_rate: Expr, steer: Expr, vehicle: Vehicle) -> Expr:
    """Eq. (3): alpha_f = delta - atan((vy + L_f omega) / vx), rad."""
    return steer - ca.atan((vy + vehicle.lf * yaw_rate) / safe_speed(vx, blend_speed(vehicle)))


def slip_rear(vx: Expr, vy: Expr, yaw_rate: Expr, vehicle: Vehicle) -> Expr:
    """Eq. (3): alpha_r = -atan((vy - L_r omega) / vx), rad."""
    return -ca.atan((vy - vehicle.lr * yaw_rate) / safe_speed(vx, blend_speed(vehicle)))
