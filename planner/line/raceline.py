"""Race line for the current model: minimum lap time of a quasi-steady point mass, and its speed profile.

The path is optimised over arc length of the centre line (Perantoni & Limebeer 2014; Christ et al. 2021, reference 8 of
the paper) with the g-g-v envelope of the model: lateral offset n, heading against the track chi and speed v are states,
path curvature and longitudinal force are controls. The profile along the finished line comes from a forward-backward
pass on a finer grid. Results are cached by content.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import casadi as ca
import numpy as np
from scipy.interpolate import CubicSpline

from estimator.model.single_track import SingleTrack
from hil_gateway.car.car import Car
from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.process.arrays import Array
from hil_gateway.process.cache import cache_directory
from hil_gateway.track.track import Track
from planner.line.envelope import MIN_NORMAL, Envelope, envelope_of, normal_share
from planner.line.speed_profile import RoadPath, lap_time_of, speed_profile

NODE_SPACING = 5.0
"""m between nodes of the optimisation"""
BEND_LENGTH = 6.0
"""m over which the vertical curve is taken: about two wheelbases, which a car cannot feel finer than"""
LINE_SPACING = 2.0
"""m between points of the finished line"""
VERSION = 3
"""of the method; part of the cache key"""


@dataclass(frozen=True)
class OptimisedLine:
    """Closed line at equal steps of its own arc length; arrays (n,), the last point does not repeat the first.

    `width_left`, `width_right` are the distances from the line to the edges of the track, m (no margin taken off);
    `bend` is the slope of the grade, rad/m (vertical curve);
    `track_s` is the arc length of the track's centre line beside each point; `heading` is continuous along the lap.
    """

    s: Array
    x: Array
    y: Array
    heading: Array
    curvature: Array
    vx_profile: Array
    width_left: Array
    width_right: Array
    grade: Array
    bank: Array
    bend: Array
    track_s: Array
    length: float
    lap_time: float
    """s: the quasi-steady minimum for this car on this track"""

    def with_envelope(self, envelope: Envelope, trust: Array | float = 1.0) -> OptimisedLine:
        """The same path with the speed profile of another model: milliseconds instead of seconds.

        `trust` (n,) is the share of the envelope that may be used at each point.
        """
        path = RoadPath(self.curvature, self.grade, self.bank, self.bend, self.length, trust)
        v = speed_profile(path, envelope)
        return replace(self, vx_profile=v, lap_time=lap_time_of(v, self.length))


def compute_raceline(
    track: Track,
    car: Car,
    tyre: Mapping[str, float],
    margin: float = 1.5,
    *,
    grip_use: float = 0.9,
    max_speed: float | None = None,
) -> OptimisedLine:
    """Minimum-time line of the declared model with tyre parameters `tyre`.

    Args:
        margin: least distance of the CoG from the edges, m (half the car's width and what the controller needs).
        grip_use: share of the tyre forces that the line may ask for.
        max_speed: m/s; that of the car where none is given.
    """
    model = SingleTrack(car.vehicle, tyre)
    theta = [tyre[p.name] for p in model.tyre_table]
    return raceline_for(
        track, envelope_of(model, theta, use=(grip_use, grip_use), max_speed=max_speed, car=car), margin
    )


def raceline_for(track: Track, envelope: Envelope, margin: float = 1.5) -> OptimisedLine:
    """Minimum-time line within `envelope`, from the cache where it was computed before."""
    path = cache_directory() / f"raceline-{_key(track, envelope, margin)}.npz"
    try:
        with np.load(path) as stored:
            return OptimisedLine(**{f.name: _unpack(stored[f.name]) for f in fields(OptimisedLine)})
    except (OSError, KeyError, ValueError):
        pass
    line = _finish(track, _optimise(track, envelope, margin), envelope)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_suffix(f".{id(line)}.npz")
    np.savez(temporary, **{f.name: getattr(line, f.name) for f in fields(OptimisedLine)})
    temporary.replace(path)
    return line


def centre_line(track: Track, envelope: Envelope) -> OptimisedLine:
    """The centre line with its speed profile: what a first lap or a failed optimisation can use."""
    return _finish(track, np.zeros(_node_count(track)), envelope)


def _key(track: Track, envelope: Envelope, margin: float) -> str:
    digest = hashlib.sha256(repr((VERSION, NODE_SPACING, LINE_SPACING, margin, envelope.key())).encode())
    for name in ("x", "y", "width_left", "width_right", "grade", "bank"):
        digest.update(np.ascontiguousarray(getattr(track, name)).tobytes())
    return digest.hexdigest()[:32]


def _unpack(array: Any) -> Any:
    return float(array) if array.ndim == 0 else array


def _node_count(track: Track) -> int:
    return max(20, round(track.length / NODE_SPACING))


def _optimise(track: Track, envelope: Envelope, margin: float) -> Array:
    """Lateral offset at equally spaced nodes of the centre line; the centre line itself if the solver fails."""
    n = _node_count(track)
    at = track.at(np.arange(n) * track.length / n)
    lower, upper = -np.maximum(at.width_right - margin, 0.0), np.maximum(at.width_left - margin, 0.0)
    path = RoadPath(at.curvature, at.grade, at.bank, bend_of(track, np.arange(n) * track.length / n), track.length)
    return _solve(_Nodes(track.length / n, path, lower, upper, speed_profile(path, envelope)), envelope)


def bend_of(track: Track, s: Array) -> Array:
    """Slope of the road's grade at arc lengths `s` (K,), rad/m: positive in a dip."""
    half = 0.5 * BEND_LENGTH
    return np.asarray((track.at(s + half).grade - track.at(s - half).grade) / BEND_LENGTH)


@dataclass(frozen=True)
class _Nodes:
    """Centre line at the nodes, bounds of the offset, and a first speed profile."""

    ds: float
    road: RoadPath
    lower: Array
    upper: Array
    speed: Array


_SPEED, _FORCE, _CURVATURE = 30.0, 10.0, 0.02
"""scales of the decision variables"""


def _solve(nodes: _Nodes, envelope: Envelope) -> Array:
    n = len(nodes.speed)
    offset, chi, v, kappa, force = (ca.SX.sym(name, n) for name in ("offset", "chi", "v", "kappa", "force"))
    state = [offset, chi, v * _SPEED, kappa * _CURVATURE, force * _FORCE]
    stretch, slopes = _motion(nodes, envelope, *state)
    defects = [_next(z) - z - 0.5 * nodes.ds * (f + _next(f)) for z, f in zip(state[:3], slopes, strict=True)]
    defects[2] = defects[2] / _SPEED
    roughness = ca.sumsqr(_next(kappa) - kappa) + 0.02 * ca.sumsqr(_next(force) - force)
    cost = nodes.ds * ca.sum1(stretch) + 0.05 * roughness
    limits = _limits(nodes, envelope, state[2], state[3], state[4])
    problem: dict[str, Any] = {
        "x": ca.vertcat(offset, chi, v, kappa, force),
        "f": cost,
        "g": ca.vertcat(*defects, *limits),
    }
    options: dict[str, Any] = {"ipopt.print_level": 0, "print_time": False, "ipopt.sb": "yes", "ipopt.max_iter": 400,
               "ipopt.tol": 1e-5, "ipopt.mu_strategy": "adaptive"}  # fmt: skip
    solver = ca.nlpsol("raceline", "ipopt", problem, options)
    ones, big = np.ones(n), np.inf
    top = envelope.max_speed / _SPEED * ones
    bend = envelope.max_curvature / _CURVATURE * ones
    result = solver(
        x0=np.concatenate(
            [
                0 * ones,
                0 * ones,
                0.9 * nodes.speed / _SPEED,
                nodes.road.curvature / _CURVATURE,
                0 * ones,
            ]
        ),
        lbx=np.concatenate([nodes.lower, -0.7 * ones, 3.0 / _SPEED * ones, -bend, -5 * ones]),
        ubx=np.concatenate([nodes.upper, 0.7 * ones, top, bend, 5 * ones]),
        lbg=np.concatenate([np.zeros(3 * n), -big * np.ones(2 * n)]),
        ubg=np.concatenate([np.zeros(3 * n), np.zeros(2 * n)]),
    )
    if not solver.stats()["success"]:
        return np.zeros(n)
    return np.array(result["x"]).ravel()[:n]


def _motion(nodes: _Nodes, envelope: Envelope, *state: Any) -> tuple[Any, list[Any]]:
    """Time per metre of centre line, s/m, and d/ds of offset, chi and speed."""
    offset, chi, v, kappa, force = state
    along = (1.0 - offset * nodes.road.curvature) / ca.cos(chi)
    drag = envelope.drag[0] + envelope.drag[1] * v * v
    slope = force - drag - GRAVITY * np.sin(nodes.road.grade)
    return along / v, [along * ca.sin(chi), along * kappa - nodes.road.curvature, along * slope / v]


def _limits(nodes: _Nodes, envelope: Envelope, v: Any, kappa: Any, force: Any) -> Sequence[Any]:
    """Friction ellipse and engine, each <= 0."""
    road = nodes.road
    lateral = v * v * kappa + GRAVITY * np.sin(road.bank)
    level, dip = normal_share(road.grade, road.bank, road.bend, kappa)
    normal = _at_least(level + dip * v * v, MIN_NORMAL)

    def most(pair: tuple[float, float]) -> Any:
        return normal * pair[0] + pair[1] * v * v

    across = lateral / most(envelope.lateral)
    # smooth minimum of traction limit and power limit
    power, traction = envelope.power / v, envelope.traction
    engine = power * traction / ca.sqrt(power**2 + traction**2)
    ellipses = [across**2 + (force / most(pair)) ** 2 - 1.0 for pair in (envelope.brake, envelope.drive)]
    # braking and driving each have their own ellipse: that of the other does not count
    return [ca.if_else(force < 0.0, *ellipses), (force - engine) / _FORCE]


def _at_least(value: Any, least: float) -> Any:
    """Smooth maximum, within 0.05 of it."""
    return least + 0.5 * (value - least + ca.sqrt((value - least) ** 2 + 0.1**2))


def _next(z: Any) -> Any:
    """z at the following node of the closed lap."""
    return ca.vertcat(z[1:], z[0])


def _finish(track: Track, offset: Array, envelope: Envelope) -> OptimisedLine:
    """Line through the offset nodes, on a uniform grid of its own arc length."""
    n = len(offset)
    at = track.at(np.arange(n) * track.length / n)
    nodes = np.column_stack([at.x - offset * np.sin(at.heading), at.y + offset * np.cos(at.heading)])
    x, y, length, dx, dy, curvature = _resample(nodes)
    heading = np.unwrap(np.arctan2(dy, dx))
    beside = _projected(track, x, y)
    lateral = np.array([p[1] for p in beside])
    track_s = np.array([p[0] for p in beside])
    road = track.at(track_s)
    bend = bend_of(track, track_s)
    v = speed_profile(RoadPath(curvature, road.grade, road.bank, bend, length), envelope)
    return OptimisedLine(
        s=np.arange(len(x)) * length / len(x), x=x, y=y, heading=heading, curvature=curvature, vx_profile=v,
        width_left=road.width_left - lateral, width_right=road.width_right + lateral,
        grade=road.grade, bank=road.bank, bend=bend, track_s=track_s, length=length, lap_time=lap_time_of(v, length),
    )  # fmt: skip


def _resample(nodes: Array) -> tuple[Array, Array, float, Array, Array, Array]:
    """Periodic spline through the nodes at equal steps of arc length: x, y, length, dx/ds, dy/ds, curvature."""
    closed = np.vstack([nodes, nodes[:1]])
    for _ in range(3):  # the spline's parameter converges to its arc length
        chord = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(closed, axis=0).T))])
        spline = CubicSpline(chord, closed, bc_type="periodic")
        fine = np.linspace(0.0, chord[-1], 8 * len(closed) + 1)
        along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(spline(fine), axis=0).T))])
        count = max(40, round(along[-1] / LINE_SPACING))
        parameter = np.interp(np.arange(count) * along[-1] / count, along, fine)
        points = spline(parameter)
        closed = np.vstack([points, points[:1]])
    d1, d2 = spline(parameter, 1), spline(parameter, 2)
    speed = np.hypot(d1[:, 0], d1[:, 1])
    curvature = (d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0]) / speed**3
    return points[:, 0], points[:, 1], float(along[-1]), d1[:, 0] / speed, d1[:, 1] / speed, curvature


def _projected(track: Track, x: Array, y: Array) -> list[tuple[float, float]]:
    """Arc length and lateral offset of each point of the line on the track's centre line."""
    found: list[tuple[float, float]] = []
    hint: float | None = None
    for px, py in zip(x.tolist(), y.tolist(), strict=True):
        found.append(track.project(px, py, hint))
        hint = found[-1][0]
    return found
