"""A minimum-time line for the simulated car: path and speed together, by direct optimal control.

Point mass over the arc length of the centre line within a smooth fit of the car's g-g-v diagram (Perantoni and
Limebeer 2014; Lot and Dal Bianco, Lap time optimisation of a racing go-kart, Vehicle System Dynamics 54 (2016)). The
fit only shapes the line. The time comes from the diagram itself, along the finished line.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from scipy.interpolate import CubicSpline

from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.plant.physics.parameters import PlantParameters
from hil_gateway.plant.physics.road import Slopes, slopes_of
from hil_gateway.plant.referee.limit_envelope import NORMALS, SHARES, SLOWEST, SPEEDS, TOP_SPEED, LimitEnvelope
from hil_gateway.plant.referee.limit_profile import LimitPath
from hil_gateway.process.arrays import Array
from hil_gateway.track.track import Track

NODE_M = 5.0
"""between nodes of the optimisation"""
STEP_M = 2.0
"""between points of the finished line"""
POWERS = ((4, 0), (3, 0), (2, 0), (1, 0), (0, 0), (2, 1), (1, 1), (0, 1), (1, 2), (0, 2))
"""exponents of speed and of the load on the road in the fits"""
FITTED = slice(2, None)
"""of `SPEEDS`, from 17 m/s on: slower, the largest lateral force with little or much load is found with the rear wheels
driving into the turn, and a polynomial that follows it there misses the fast turns by 0.7 % of a lap"""
V0, A0, K0 = 30.0, 10.0, 0.02
"""scales of speed, force over mass and curvature"""


class NoLineError(ArithmeticError):
    """The optimisation of the line did not converge."""


@dataclass(frozen=True)
class LineFit:
    """Smooth envelope: coefficients of `POWERS` of the lateral limit, of the drag there, of what brakes and engine add
    to that drag at most, and exponents of the superellipses that join them to the lateral limit."""

    lateral: Array
    drag: Array
    brake: Array
    drive: Array
    brake_power: float
    drive_power: float


def fit(envelope: LimitEnvelope) -> LineFit:
    """Least-squares fit over speeds and loads, without wind, both sides alike."""
    calm = len(envelope.headwinds) // 2
    tables = envelope.lateral, envelope.drive, -envelope.brake
    lateral, drive, brake = (table.mean(axis=0)[calm, FITTED] for table in tables)
    drag = brake[..., -1]
    v, normal = np.meshgrid(SPEEDS[FITTED] / V0, NORMALS / GRAVITY, indexing="ij")
    basis = np.stack([(v**a * normal**b).ravel() for a, b in POWERS], axis=-1)

    def coefficients(values: Array) -> Array:
        return np.asarray(np.linalg.lstsq(basis, values.ravel() / A0, rcond=None)[0])

    return LineFit(
        lateral=coefficients(lateral),
        drag=coefficients(drag),
        brake=coefficients(brake[..., 0] - drag),
        drive=coefficients(drive[..., 0] + drag),
        brake_power=_exponent(brake),
        drive_power=_exponent(drive),
    )


def _exponent(table: Array) -> float:
    """Exponent p of share^p + (along / most)^p = 1 that fits best."""
    inner = (table[..., 1:-1] - table[..., -1:]) / (table[..., :1] - table[..., -1:])
    tried = np.linspace(1.3, 3.5, 45)
    errors = [np.abs((1.0 - SHARES[1:-1] ** p) ** (1 / p) - np.clip(inner, 0.0, 1.0)).mean() for p in tried]
    return float(tried[int(np.argmin(errors))])


def fastest_line(track: Track, parameters: PlantParameters, envelope: LimitEnvelope, margin: float) -> LimitPath:
    """Minimum-time line with the car's centre at least `margin` m from the edges.

    Raises:
        NoLineError: the optimisation did not converge.
    """
    nodes = _LimitNodes.of(track, parameters, margin)
    return _path(track, parameters, _solve(nodes, fit(envelope)))


@dataclass(frozen=True)
class _LimitNodes:
    """Centre line at equal steps `ds` (m): curvature, slopes and bounds of the lateral offset (m), shape (n,)."""

    ds: float
    curvature: Array
    slopes: Slopes
    lower: Array
    upper: Array

    @classmethod
    def of(cls, track: Track, parameters: PlantParameters, margin: float) -> _LimitNodes:
        n = max(40, round(track.length / NODE_M))
        s = np.arange(n) * track.length / n
        at = track.at(s)
        lower, upper = -np.maximum(at.width_right - margin, 0.0), np.maximum(at.width_left - margin, 0.0)
        return cls(track.length / n, at.curvature, _slopes_at(track, parameters, s), lower, upper)


def _slopes_at(track: Track, parameters: PlantParameters, s: Array) -> Slopes:
    at, values = np.append(track.s, track.length), slopes_of(track, parameters.road)
    return Slopes(*(np.interp(s % track.length, at, np.append(row, row[0])) for row in values))


def _solve(nodes: _LimitNodes, shape: LineFit) -> Array:
    """Lateral offset at the nodes, m."""
    n, ones = len(nodes.curvature), np.ones(len(nodes.curvature))
    names = ("offset", "chi", "v", "kappa", "drive", "brake")
    z = dict(zip(names, (ca.SX.sym(name, n) for name in names), strict=True))
    states = z["offset"], z["chi"], z["v"] * V0
    normal = _normal(nodes, states[2], z["kappa"] * K0)
    force = z["drive"] - z["brake"] - _surface(shape.drag, z["v"], normal)
    stretch, slopes = _motion(nodes, states, z["kappa"] * K0, force * A0)
    defects = [_next(x) - x - 0.5 * nodes.ds * (f + _next(f)) for x, f in zip(states, slopes, strict=True)]
    defects[2] = defects[2] / V0
    smooth = [ca.sumsqr(_next(z[name]) - z[name]) for name in ("kappa", "drive", "brake")]
    limits = _limits(nodes, shape, z, normal)
    problem: dict[str, Any] = {
        "x": ca.vertcat(*z.values()),
        "f": nodes.ds * ca.sum1(stretch) + 0.02 * smooth[0] + 2e-3 * (smooth[1] + smooth[2]),
        "g": ca.vertcat(*defects, *limits),
    }
    options: dict[str, Any] = {"ipopt.print_level": 0, "print_time": False, "ipopt.sb": "yes", "ipopt.max_iter": 500,
               "ipopt.tol": 1e-5, "ipopt.mu_strategy": "adaptive", "error_on_fail": False}  # fmt: skip
    solver = ca.nlpsol("line", "ipopt", problem, options)
    slow = np.clip(0.7 * np.sqrt(10.0 / np.maximum(np.abs(nodes.curvature), 2e-3)), SLOWEST, 60.0)
    result = solver(
        x0=np.concatenate([0 * ones, 0 * ones, slow / V0, nodes.curvature / K0, 0.1 * ones, 0.1 * ones]),
        lbx=np.concatenate([nodes.lower, -0.7 * ones, SLOWEST / V0 * ones, -5 * ones, 0 * ones, 0 * ones]),
        ubx=np.concatenate([nodes.upper, 0.7 * ones, TOP_SPEED / V0 * ones, 5 * ones, 8 * ones, 8 * ones]),
        lbg=np.concatenate([np.zeros(3 * n), -np.inf * np.ones(2 * n)]),
        ubg=np.concatenate([np.zeros(3 * n), np.ones(2 * n)]),
    )
    if not solver.stats()["success"]:
        raise NoLineError(f"no minimum-time line: the optimisation ended with {solver.stats()['return_status']}")
    return np.array(result["x"]).ravel()[:n]


def _motion(nodes: _LimitNodes, states: tuple[Any, Any, Any], kappa: Any, force: Any) -> tuple[Any, list[Any]]:
    """Time per metre of centre line, s/m, and d/ds of offset, heading against the track and speed."""
    offset, chi, v = states
    along = (1.0 - offset * nodes.curvature) / ca.cos(chi)
    slope = force - GRAVITY * np.sin(nodes.slopes.grade)
    return along / v, [along * ca.sin(chi), along * kappa - nodes.curvature, along * slope / v]


def _normal(nodes: _LimitNodes, v: Any, kappa: Any) -> Any:
    """Load on the road over the weight of the car."""
    weight = np.cos(nodes.slopes.grade) * np.cos(nodes.slopes.bank)
    return weight + v * v * (nodes.slopes.bend - kappa * np.sin(nodes.slopes.bank)) / GRAVITY


def _limits(nodes: _LimitNodes, shape: LineFit, z: dict[str, Any], normal: Any) -> list[Any]:
    """Braking and driving superellipse, each at most 1."""

    def most(row: Array) -> Any:
        value = _surface(row, z["v"], normal)
        return 0.5 * (value + ca.sqrt(value**2 + 0.02**2))  # positive, wherever the search passes

    across = (z["v"] * V0) ** 2 * z["kappa"] * K0 + GRAVITY * np.sin(nodes.slopes.bank)
    lateral = across / A0 / most(shape.lateral)
    return [
        _power(lateral, p) + _power(z[way] / most(row), p)
        for way, row, p in (("brake", shape.brake, shape.brake_power), ("drive", shape.drive, shape.drive_power))
    ]


def _surface(row: Array, v: Any, normal: Any) -> Any:
    """A fit at scaled speed and load."""
    return sum(c * v**a * normal**b for c, (a, b) in zip(row, POWERS, strict=True))


def _power(x: Any, p: float) -> Any:
    """|x|^p, smooth at zero."""
    return (x * x + 1e-6) ** (0.5 * p)


def _next(z: Any) -> Any:
    return ca.vertcat(z[1:], z[0])


def _path(track: Track, parameters: PlantParameters, offset: Array) -> LimitPath:
    """The line through the offset nodes at equal steps of its own arc length."""
    n = len(offset)
    at = track.at(np.arange(n) * track.length / n)
    points = np.column_stack([at.x - offset * np.sin(at.heading), at.y + offset * np.cos(at.heading)])
    spline, length = _spline(points)
    count = round(length / STEP_M)
    u = np.arange(count) * length / count
    (dx, dy), (ddx, ddy) = spline(u, 1).T, spline(u, 2).T
    yaw = np.unwrap(np.arctan2(dy, dx))
    track_s = _arc_lengths(track, spline(u))
    curvature = (dx * ddy - dy * ddx) / np.hypot(dx, dy) ** 3
    slopes = _slopes_at(track, parameters, track_s)
    return LimitPath(length / count, yaw, yaw - track.at(track_s).heading, curvature, slopes)


def _spline(points: Array) -> tuple[CubicSpline, float]:
    """Periodic spline over its own arc length, and that length, m."""
    for _ in range(3):
        closed = np.vstack([points, points[:1]])
        chord = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(closed, axis=0).T))])
        spline = CubicSpline(chord, closed, bc_type="periodic")
        fine = np.linspace(0.0, chord[-1], 20 * len(points) + 1)
        along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(spline(fine), axis=0).T))])
        points = spline(np.interp(np.arange(len(points)) * along[-1] / len(points), along, fine))
    closed = np.vstack([points, points[:1]])
    return CubicSpline(np.linspace(0.0, along[-1], len(closed)), closed, bc_type="periodic"), float(along[-1])


def _arc_lengths(track: Track, points: Array) -> Array:
    """Arc length of the centre line beside every point, m."""
    s, out = track.project(*points[0])[0], []
    for x, y in points:
        s = track.project(float(x), float(y), s)[0]
        out.append(s)
    return np.array(out)
