"""What the current model says the car can do at each speed: the g-g-v diagram the race line is made with.

Quasi-steady: the axles share the lateral force as in steady cornering, the rear axle alone drives and brakes
(Eq. 1), each within a friction ellipse. Speed dependence is kept as c0 + c2 v^2, exact for drag and downforce.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from estimator.model.effects import catalogue
from estimator.model.parameters import Layout
from estimator.model.single_track import SIGNALS, SingleTrack, Terms
from hil_gateway.car.vehicle import GRAVITY, Vehicle
from hil_gateway.process.arrays import Array

AIR_DENSITY = 1.2
DECLARED_DRAG_AREA = 0.86
"""Cd A of the AV-24, m2: bounds the speed even while the model knows no drag"""
ENGINE_POWER = 0.9 * 473 * 745.7
"""W at the wheels: 473 hp less driveline losses"""
MAX_TRACTION = 7500.0
"""N, lowest useful gear"""
MAX_STEER = 0.279


@dataclass(frozen=True)
class Envelope:
    """Limits over speed; pairs (c0, c2) mean c0 + c2 v^2, m/s2."""

    lateral: tuple[float, float]
    """specific lateral force in steady cornering"""
    longitudinal: tuple[float, float]
    """specific force the rear axle can put down, either way"""
    drag: tuple[float, float]
    """deceleration when coasting"""
    power: float
    """engine power over mass, W/kg"""
    traction: float
    """largest driving specific force, m/s2"""
    max_speed: float
    max_curvature: float

    def at(self, pair: tuple[float, float], v: Array) -> Array:
        """Value of one of the pairs at speed `v`."""
        return np.asarray(pair[0] + pair[1] * v * v)

    def key(self) -> str:
        """Content, for caches."""
        return repr({k: np.round(value, 6) for k, value in asdict(self).items()})


def envelope_of(
    model: SingleTrack,
    theta: Sequence[float],
    phi: Sequence[float] = (),
    *,
    grip_use: float = 0.9,
    max_speed: float = 80.0,
) -> Envelope:
    """Envelope of a model, using the share `grip_use` of its tyre forces."""
    speeds = np.array([15.0, 30.0, 45.0, 60.0, 75.0])
    front, rear, coast = _peak_forces(model, theta, phi, speeds)
    v = model.vehicle
    lateral = grip_use * np.minimum(front * v.wheelbase / v.lr, rear * v.wheelbase / v.lf) / v.mass
    return Envelope(
        lateral=_fit(speeds, lateral),
        longitudinal=_fit(speeds, grip_use * rear / v.mass),
        drag=_fit(speeds, np.maximum(coast, _declared_drag(v, speeds))),
        power=ENGINE_POWER / v.mass,
        traction=MAX_TRACTION / v.mass,
        max_speed=max_speed,
        max_curvature=float(np.tan(0.9 * MAX_STEER)) / v.wheelbase,
    )


def _peak_forces(
    model: SingleTrack, theta: Sequence[float], phi: Sequence[float], speeds: Array
) -> tuple[Array, Array, Array]:
    """Largest lateral force of the front and rear axle, N, and coasting deceleration, m/s2, each (len(speeds),)."""
    slips = np.linspace(0.0, 0.35, 71)
    forces = _forces(model.vehicle, model.layout, tuple(effect.name for effect in model.effects))
    v, slip = (a.ravel() for a in np.meshgrid(speeds, slips, indexing="ij"))
    zero = np.zeros_like(v)
    values: Any = forces(np.vstack([v, -v * np.tan(slip), zero, zero, zero]), list(theta), list(phi))
    table = np.array(values).reshape(3, len(speeds), len(slips))
    return table[0].max(axis=1), table[1].max(axis=1), -table[2, :, 0]


@lru_cache(maxsize=4)
def _forces(vehicle: Vehicle, layout: Layout, effects: tuple[str, ...]) -> ca.Function:
    """(signals, theta, phi) -> lateral force of both axles, N, and longitudinal specific force, m/s2."""
    model = SingleTrack(vehicle, layout, tuple(catalogue()[name] for name in effects))
    signals = ca.SX.sym("signals", len(SIGNALS))
    named = dict(zip(SIGNALS, ca.vertsplit(signals), strict=True))
    theta, phi = ca.SX.sym("theta", len(model.tyre_table)), ca.SX.sym("phi", len(model.effect_table))
    parameters = [ca.vertsplit(p) if p.numel() else [] for p in (theta, phi)]
    terms = model.evaluate(Terms(model.vehicle, **named, aux=_Neutral()), *parameters)
    arguments: Any = [signals, theta, phi]
    return ca.Function("forces", arguments, [ca.vertcat(terms.fy_f, terms.fy_r, terms.imu_ax)])


class _Neutral(dict[str, float]):
    """Every auxiliary signal at its neutral value."""

    def __missing__(self, key: str) -> float:
        return 0.0


def _declared_drag(vehicle: Vehicle, speeds: Array) -> Array:
    return np.asarray(0.5 * AIR_DENSITY * DECLARED_DRAG_AREA * speeds**2 / vehicle.mass)


def _fit(speeds: Array, values: Array) -> tuple[float, float]:
    """c0, c2 of c0 + c2 v^2 by least squares, never above the values."""
    c2, c0 = np.polyfit(speeds**2, values, 1)
    return float(c0 + min(0.0, np.min(values - c0 - c2 * speeds**2))), float(c2)


def required_lateral(curvature: Array, bank: Array, v: Array) -> Array:
    """Specific force needed to hold a path: a_y = v^2 kappa + g sin(bank), m/s2."""
    return np.asarray(v * v * curvature + GRAVITY * np.sin(bank))
