"""What the current model says the car can do at each speed: the g-g-v diagram the race line is made with.

Quasi-steady, each axle within a friction ellipse of its own: in steady cornering they share the lateral force by their
distance from the centre of gravity, the drive goes to the axles the model sends it to. What a tyre can give grows with
the load the road puts on it: a limit is n c0 + c2 v^2 with n the acceleration the road gives the car, over gravity, 1
on level ground (`normal_share`). c2 is downforce; the form is exact for the model's downforce, load transfer and drag.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from threading import Lock
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from estimator.model.effects import catalogue
from estimator.model.parameters import LAYOUTS, Layout
from estimator.model.single_track import SIGNALS, SingleTrack, Terms
from hil_gateway.car.car import Car
from hil_gateway.car.vehicle import GRAVITY, Vehicle
from hil_gateway.process.arrays import Array
from hil_gateway.process.compiled import compile_function
from planner.line.longitudinal_reserve import SPEEDS, Table, longitudinal_reserve
from planner.problem.brake_law import BrakeLaw
from planner.problem.friction import along_share, left_across

SPEED_LEFT = 2.0
"""m/s below the fastest that a plan may hold: a race line leaves it room"""
MIN_NORMAL = 0.2
"""share of gravity that is left on a crest at least: a car that takes off needs another model"""
COMMANDS = np.concatenate([np.linspace(-0.5, 0.0, 401), np.linspace(0.00125, 0.3, 240)])
"""drive commands among which the largest that the tyres bear is sought, 60 N apart: half a percent of what they bear"""
SLIPS = np.linspace(0.0, 0.35, 71)
BLOCK = len(COMMANDS)
"""points the compiled forces are evaluated at in one call"""


class Brakes(NamedTuple):
    """The law of the brakes, its ratio of the pressures, and how many times braking forces count, front and rear."""

    law: BrakeLaw | None = None
    ratio: float = 1.0
    doubt: tuple[float, float] = (1.0, 1.0)


AS_MODELLED = Brakes()
"""split as the model has it, with forces as they are"""


@dataclass(frozen=True)
class Envelope:
    """Limits over speed; pairs (c0, c2) mean n c0 + c2 v^2, m/s2."""

    lateral: tuple[float, float]
    """specific lateral force in steady cornering"""
    brake: tuple[float, float]
    """specific braking force of the tyres"""
    drive: tuple[float, float]
    """specific driving force the tyres can put down"""
    brake_left: Table
    """share of `brake` that cornering leaves"""
    drive_left: Table
    """share of `drive` that cornering leaves"""
    drag: tuple[float, float]
    """deceleration when coasting, whatever n is"""
    power: float
    """engine power over mass, W/kg"""
    traction: float
    """largest driving specific force, m/s2"""
    max_speed: float
    max_curvature: float

    def at(self, pair: tuple[float, float], v: Array) -> Array:
        """Value of one of the pairs at speed `v` on level ground."""
        return np.asarray(pair[0] + pair[1] * v * v)

    def braked(self, most: float) -> Envelope:
        """The same with brakes that shed `most` m/s2 at any speed."""
        c0, c2 = self.brake
        return replace(self, brake=(min(c0, most), min(c2, max(most - c0, 0.0) / self.max_speed**2)))

    def key(self) -> str:
        """Content, for caches."""
        return repr({k: np.round(value, 6) for k, value in asdict(self).items()})


class Peaks(NamedTuple):
    """Of a model at `SPEEDS`, m/s2: most lateral specific force in steady cornering; braking, driving and coasting; and
    what cornering leaves of braking and driving."""

    lateral: Array
    brake: Array
    drive: Array
    coast: Array
    brake_left: Table
    drive_left: Table


def envelope_of(
    model: SingleTrack,
    theta: Sequence[float],
    phi: Sequence[float] = (),
    *,
    use: tuple[float, float] = (0.9, 0.9),
    car: Car,
    max_speed: float | None = None,
    brakes: Brakes = AS_MODELLED,
) -> Envelope:
    """Envelope of a model, using the shares `use` of the tyre forces of the front and of the rear axle.

    `car`: whose engine, steering and fastest speed count. What the wheels get of the engine's power is for the plan to
    find.
    """
    train = car.powertrain
    peaks, v = _peaks(model, theta, phi, use, brakes), model.vehicle
    return Envelope(
        lateral=_fit(peaks.lateral),
        brake=_fit(peaks.brake),
        drive=_fit(peaks.drive),
        brake_left=peaks.brake_left,
        drive_left=peaks.drive_left,
        drag=_fit(np.maximum(peaks.coast, _declared_drag(v))),
        power=train.power_max / v.mass,
        traction=train.traction_max / v.mass,
        max_speed=max_speed or car.actuators.speed_max - SPEED_LEFT,
        max_curvature=float(np.tan(0.9 * car.actuators.steering_range)) / v.wheelbase,
    )


def _peaks(
    model: SingleTrack, theta: Sequence[float], phi: Sequence[float], use: tuple[float, float], brakes: Brakes
) -> Peaks:
    forces = _forces(model.vehicle, model.layout, tuple(effect.name for effect in model.effects), brakes.law)

    def table(slips: Array, commands: Array) -> Array:
        """At `SPEEDS` and every one of `commands` (K,) or (speeds, K), with the slip angle beside it."""
        speed, command = np.broadcast_arrays(SPEEDS[:, None], commands)
        slip, zero = np.broadcast_to(slips, speed.shape), np.zeros(speed.size)
        signals = np.vstack([speed.ravel(), -(speed * np.tan(slip)).ravel(), zero, zero, command.ravel()])
        return forces(signals, theta, phi, brakes.ratio).reshape(7, len(SPEEDS), -1)

    along = table(np.zeros_like(COMMANDS), COMMANDS)
    coast = -along[4, :, np.flatnonzero(COMMANDS == 0.0)[0]]
    # steady: driven against drag, which would put load on the front axle when coasting
    steady = np.clip(coast, 0.0, None) * model.vehicle.mass / theta[0]
    sideways = table(SLIPS, np.repeat(steady[:, None], len(SLIPS), axis=1))[:2].max(axis=2)
    lateral = _lateral(model.vehicle, use[0] * sideways[0], use[1] * sideways[1])
    along[2:4] *= np.where(COMMANDS < 0.0, np.array(brakes.doubt)[:, None, None], 1.0)
    felt, front, rear = _feasible_forces(along, coast, use, float(along_share(model, phi)))
    (brake, brake_left), (drive, drive_left) = _along(felt, _lateral(model.vehicle, front, rear), steady)
    return Peaks(lateral, brake, drive, coast, brake_left, drive_left)


def _feasible_forces(along: Array, coast: Array, use: tuple[float, float], counts: float) -> tuple[Array, Array, Array]:
    """Of the rows of `_Forces` at all `COMMANDS`: acceleration by a command, m/s2, 0 where an axle does not bear it,
    and the forces across that front and rear axle bear beside it, N.

    `coast` in m/s2, `counts` what braking does on a straight (`along_share`).
    """
    within, brakes = np.array(use)[:, None, None], COMMANDS < 0.0
    shares = np.abs(along[2:4]) / within
    felt = np.where((np.where(brakes, counts, 1.0) * shares < 1.0).all(axis=0), along[4] + coast[:, None], 0.0)
    front, rear = np.where(brakes, left_across(counts, shares), left_across(1.0, shares)) * along[5:] * within
    return felt, front, rear


def _along(felt: Array, across: Array, steady: Array) -> list[tuple[Array, Table]]:
    """Most specific force of braking, and of driving, m/s2, at `SPEEDS`, and what cornering leaves of it.

    `felt` and `across` in m/s2 at `SPEEDS` and `COMMANDS`, `steady` the commands that hold the speeds.
    """
    held = np.array([np.interp(d, COMMANDS, row) for d, row in zip(steady, across, strict=True)])
    ways = []
    for way, part in ((-1.0, COMMANDS <= 0.0), (1.0, COMMANDS >= 0.0)):
        outwards = np.flatnonzero(part)[:: int(way)]
        force = np.maximum.accumulate(np.maximum(way * felt[:, outwards], 0.0), axis=1)
        ways.append((force[:, -1], longitudinal_reserve(force, across[:, outwards], held)))
    return ways


def _lateral(vehicle: Vehicle, front: Array, rear: Array) -> Array:
    """Specific force across that axles with the forces `front` and `rear`, N, hold in steady cornering, m/s2."""
    return np.asarray(np.minimum(front / vehicle.lr, rear / vehicle.lf) * vehicle.wheelbase / vehicle.mass)


class _Forces:
    """Of front and rear axle: lateral force, N, share of the peak used along; longitudinal m/s2; peaks, N: 7 rows."""

    def __init__(self, function: ca.Function) -> None:
        mapped: ca.Function = function.map("forces", "serial", BLOCK, [1, 2, 3], [])
        self._function, self._lock = compile_function(mapped), Lock()

    def __call__(self, signals: Array, theta: Sequence[float], phi: Sequence[float], ratio: float) -> Array:
        """Of signals (5, K), in the order of `SIGNALS`, with the parameters of the model and the brakes' ratio."""
        given, tyre, effects, brakes = self._function.inputs
        blocks = []
        with self._lock:
            tyre[:, 0], effects[:, 0], brakes[:] = theta, phi, ratio
            for first in range(0, signals.shape[1], BLOCK):
                block = signals[:, first : first + BLOCK]
                given[:, : block.shape[1]] = block
                self._function()
                blocks.append(self._function.outputs[0][:, : block.shape[1]].copy())
        return np.hstack(blocks)


@lru_cache(maxsize=4)
def _forces(vehicle: Vehicle, layout: Layout, effects: tuple[str, ...], brakes: BrakeLaw | None) -> _Forces:
    model = SingleTrack(vehicle, dict.fromkeys(LAYOUTS[layout], 1.0), tuple(catalogue()[name] for name in effects))
    signals = ca.SX.sym("signals", len(SIGNALS))
    named = dict(zip(SIGNALS, ca.vertsplit(signals), strict=True))
    theta, phi = ca.SX.sym("theta", len(model.tyre_table)), ca.SX.sym("phi", len(model.effect_table))
    parameters = [ca.vertsplit(p) if p.numel() else [] for p in (theta, phi)]
    ratio = ca.SX.sym("ratio")
    aux = {"brake_balance": brakes.balance(named["vx"], named["drive"], ratio, 0.0)} if brakes else {}
    t = model.evaluate(Terms(model.vehicle, **named, aux=_Neutral(aux)), *parameters)
    arguments: Any = [signals, theta, phi, ratio]
    outputs = ca.vertcat(t.fy_f, t.fy_r, t.fx_f / t.peak_f, t.fx_r / t.peak_r, t.imu_ax, t.peak_f, t.peak_r)
    return _Forces(ca.Function("forces_at", arguments, [ca.densify(outputs)]))


class _Neutral(dict[str, Any]):
    """Every other auxiliary signal at its neutral value."""

    def __missing__(self, key: str) -> float:
        return 0.0


def _declared_drag(vehicle: Vehicle) -> Array:
    return np.array([vehicle.drag(speed) for speed in SPEEDS.tolist()])


def _fit(values: Array) -> tuple[float, float]:
    """c0, c2 of c0 + c2 v^2 by least squares, never above the values."""
    c2, c0 = np.polyfit(SPEEDS**2, values, 1)
    return float(c0 + min(0.0, np.min(values - c0 - c2 * SPEEDS**2))), float(c2)


def normal_share(grade: Array, bank: Array, bend: Array, curvature: Array) -> tuple[Array, Array]:
    """n = a + b v^2: acceleration the road gives the car along its normal, over gravity, on a path of `curvature`.

    Weight, the vertical curve (`bend`, rad/m: heavier in a dip) and the part of the centripetal acceleration that a
    bank takes.
    """
    return np.cos(grade) * np.cos(bank), (bend - curvature * np.sin(bank)) / GRAVITY


def required_lateral(curvature: Array, bank: Array, v: Array) -> Array:
    """Specific force needed to hold a path: a_y = v^2 kappa + g sin(bank), m/s2."""
    return np.asarray(v * v * curvature + GRAVITY * np.sin(bank))
