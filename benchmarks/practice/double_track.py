"""A double-track car apart from the paper's equations, the estimator's effects and the simulated car of the gateway.

Four wheels with slip ratios and relaxed slip angles, tyres by similarity (Pacejka, Tire and Vehicle Dynamics, ch. 4.3),
with load sensitivity, lagging load transfer, aerodynamic axle loads, four brakes, a rear axle with a limited-slip
differential, power limit, engine braking; road with bank, grade and vertical curvature, wind, wet laps. Many things at
once that Eq. 1-3 lack, each with a size known: a diagnosis must name the large ones and leave little.

Wheels are ordered front left, front right, rear left, rear right; a column a drive.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from hil_gateway.process.arrays import Array

from .drive import COURSES, STATIONS

GRAVITY = 9.80665
MASS, INERTIA, LF, LR, TRACK_F, TRACK_R = 787.0, 1000.0, 1.7238, 1.248, 1.638, 1.523
WHEELBASE = LF + LR
PLACE = np.array([[LF, LF, -LR, -LR], [TRACK_F / 2, -TRACK_F / 2, TRACK_R / 2, -TRACK_R / 2]])
"""x and y of the wheels, m"""
STATIC = MASS * GRAVITY / (2 * WHEELBASE) * np.array([LR, LR, LF, LF])
"""load of each wheel at rest, N"""
WHEEL_TIME, LOAD_TIME, RELAXATION = 0.015, 0.12, 0.25
"""s, s and m: slip ratios follow the torque, loads the acceleration, slip angles the way travelled"""
BRAKE_PRESSURE = 1.5e6
"""Pa, with the brake pedal down"""
BRAKE_FORCE, DRIVE_FORCE = 13500.0, 8200.0
"""N of all four brakes with the pedal down, and of the engine at full throttle"""


@dataclass(frozen=True)
class Setup:
    """One double-track car and its road.

    Attributes:
        drag, downforce: N s2/m2, the latter of front and rear axle.
        brake_front: share of the brake force on the front axle; engine_braking: N with the throttle closed.
        height: of the centre of gravity, m; roll_front: share of the lateral load transfer that the front axle bears.
        grip, stiffness: of a tyre at its static load, front and rear; sensitivity: loss of grip with load.
        bank, grade: rad; of the turns of an oval, or the size of waves on a road course.
        wind: m/s; wet: laps in which a stretch, a share `wet_length` of the lap, has `wet_grip` of the grip.
        pace: share of the grip that the last lap asks for; fastest: m/s.
        power: of the engine, W; lock: share of the torque that the differential can move.
    """

    course: str = "road"
    laps: int = 8
    pace: float = 0.78
    drag: float = 0.52
    downforce: tuple[float, float] = (0.39, 0.71)
    brake_front: float = 0.56
    engine_braking: float = 500.0
    height: float = 0.275
    roll_front: float = 0.55
    grip: tuple[float, float] = (1.55, 1.62)
    stiffness: tuple[float, float] = (20.0, 24.0)
    sensitivity: float = 0.12
    bank: float = 0.0
    grade: float = 0.0
    wind: float = 0.0
    wet: tuple[int, ...] = ()
    wet_length: float = 0.1
    wet_grip: float = 0.7
    fastest: float = 60.0
    power: float = 345e3
    lock: float = 0.25


class Course(NamedTuple):
    """The road of every car on equal stations: length (n,) in m, all others (n, STATIONS) in m, 1/m and rad."""

    length: Array
    curvature: Array
    x: Array
    y: Array
    heading: Array
    bank: Array
    grade: Array
    vertical: Array


@dataclass
class State:
    """Motion of all cars (n,), and of their wheels (4, n)."""

    share: Array
    offset: Array
    mu: Array
    yaw: Array
    vx: Array
    vy: Array
    rate: Array
    kappa: Array
    alpha: Array
    felt: Array

    def moved(self, by: State, h: float) -> State:
        """This state after `h` s of the derivative `by`."""
        return State(*(a + h * b for a, b in zip(vars(self).values(), vars(by).values(), strict=True)))


@dataclass
class Pedals:
    """What the driver does: steering (rad), throttle and brake (0 to 1), (n,) each."""

    steer: Array
    throttle: Array
    brake: Array


@dataclass(frozen=True)
class Forces:
    """On the body: specific forces, yaw acceleration (n,); on the wheels: what the torque asks of each, N, and gets."""

    ax: Array
    ay: Array
    yaw_acc: Array
    asked: Array = field(repr=False)
    given: Array = field(repr=False)
    slip: Array = field(repr=False)


class DoubleTrack:
    """Cars side by side, one a column."""

    def __init__(self, setups: Sequence[Setup], seeds: Sequence[int]) -> None:
        self.setups, n = setups, len(setups)
        self.of = {name: np.array([getattr(s, name) for s in setups]).T for name in _NUMBERS}
        generators = [np.random.default_rng([seed, 11]) for seed in seeds]
        self.course = Course(*(np.array(c) for c in zip(*map(_course, setups, generators), strict=True)))
        self.wind_from = np.array([g.uniform(0, 2 * np.pi) for g in generators])
        self.wet_at = np.array([g.uniform(0.1, 0.7) for g in generators])
        self.wet = np.array([[lap in s.wet for lap in range(s.laps + 1)] for s in setups])
        self.rows = np.arange(n)
        pairs = [("grip", 0), ("grip", 0), ("grip", 1), ("grip", 1)]
        self.mu = np.array([self.of[name][axle] for name, axle in pairs])
        self.stiffness = np.array([self.of["stiffness"][axle] for _, axle in pairs])

    def road(self, share: Array) -> tuple[Array, ...]:
        """Curvature, bank, grade and vertical curvature at a share of the lap."""
        at = (share % 1.0 * STATIONS).astype(int) % STATIONS
        c = self.course
        return tuple(profile[self.rows, at] for profile in (c.curvature, c.bank, c.grade, c.vertical))

    def loads(self, z: State, road: tuple[Array, ...]) -> Array:
        """(4, n) N: weight across the road, air, and the transfer of what was felt shortly before."""
        kappa, bank, grade, vertical = road
        normal = GRAVITY * np.cos(bank) * np.cos(grade) + z.vx**2 * (vertical - kappa * np.sin(bank))
        air = np.repeat(self.of["downforce"], 2, axis=0) * z.vx**2 / 2
        along = MASS * self.of["height"] * z.felt[0] / (2 * WHEELBASE) * np.array([[-1.0], [-1.0], [1.0], [1.0]])
        across = MASS * self.of["height"] * z.felt[1]
        front = across * self.of["roll_front"] / TRACK_F
        rear = across * (1 - self.of["roll_front"]) / TRACK_R
        load = STATIC[:, None] * normal / GRAVITY + air + along + np.array([-front, front, -rear, rear])
        return np.asarray(np.maximum(load, 50.0))

    def torques(self, z: State, pedals: Pedals, slip: Array) -> Array:
        """(4, n) N that brakes and engine ask of each wheel; the differential moves some to the slower rear wheel."""
        brake = pedals.brake * BRAKE_FORCE
        drive = np.minimum(pedals.throttle * DRIVE_FORCE, self.of["power"] / z.vx)
        drive = drive - self.of["engine_braking"] * (pedals.throttle <= 0.0)
        front, rear = -brake * self.of["brake_front"] / 2, (drive - brake * (1 - self.of["brake_front"])) / 2
        faster = z.vx * (slip[2] - slip[3]) - z.rate * TRACK_R
        moved = (150.0 + self.of["lock"] * np.abs(rear)) * np.tanh(faster / 0.5)
        return np.array([front, front, rear - moved, rear + moved])

    def forces(self, z: State, pedals: Pedals) -> Forces:
        """Everything that acts on the cars."""
        road = self.road(z.share)
        load = self.loads(z, road)
        grip = self.mu * (1 - self.of["sensitivity"] * (load / STATIC[:, None] - 1)) * self.dry(z)
        stretched = self.stiffness / np.maximum(grip, 0.1)
        sx, sy = stretched * z.kappa, stretched * np.tan(z.alpha)
        total = np.hypot(sx, sy) + 1e-9
        force = (
            grip * load * np.sin(1.5 * np.arctan(total / 1.5 - 0.1 * (total / 1.5 - np.arctan(total / 1.5)))) / total
        )
        fx, fy = force * sx, force * sy
        steer = np.array([pedals.steer, pedals.steer, 0 * pedals.steer, 0 * pedals.steer])
        x, y = fx * np.cos(steer) - fy * np.sin(steer), fx * np.sin(steer) + fy * np.cos(steer)
        air_x, air_y = self.air(z)
        yaw_acc = (PLACE[0][:, None] * y - PLACE[1][:, None] * x).sum(axis=0) / INERTIA
        ax, ay = (x.sum(axis=0) + air_x) / MASS, (y.sum(axis=0) + air_y) / MASS
        speed = np.array([z.vx - z.rate * PLACE[1][i] for i in range(4)])
        slip = steer - np.arctan2(z.vy + PLACE[0][:, None] * z.rate, speed)
        return Forces(ax, ay, yaw_acc, self.torques(z, pedals, z.kappa), fx, slip)

    def dry(self, z: State) -> Array:
        """(n,) factor on the grip: wet on a stretch of some laps."""
        lap, place = z.share.astype(int), z.share % 1.0
        wet = self.wet[self.rows, np.minimum(lap, self.wet.shape[1] - 1)]
        there = np.abs(place - self.wet_at) < self.of["wet_length"] / 2
        return np.where(wet & there, self.of["wet_grip"], 1.0)

    def air(self, z: State) -> tuple[Array, Array]:
        """Force of the air on the body, N."""
        against = self.wind_from - z.yaw
        vx, vy = z.vx - self.of["wind"] * np.cos(against), z.vy - self.of["wind"] * np.sin(against)
        speed = np.hypot(vx, vy)
        return -self.of["drag"] * speed * vx, -0.7 * speed * vy

    def rates(self, z: State, pedals: Pedals) -> tuple[State, Forces]:
        """Derivative of the state, and the forces there."""
        f = self.forces(z, pedals)
        kappa, bank, grade, _ = self.road(z.share)
        along = (z.vx * np.cos(z.mu) - z.vy * np.sin(z.mu)) / (1 - kappa * z.offset)
        speed = np.maximum(z.vx, 5.0)
        by = State(
            along / self.course.length,
            z.vx * np.sin(z.mu) + z.vy * np.cos(z.mu),
            z.rate - kappa * along,
            z.rate,
            f.ax + z.vy * z.rate - GRAVITY * np.sin(grade),
            f.ay - z.vx * z.rate - GRAVITY * np.sin(bank),
            f.yaw_acc,
            (f.asked - f.given) / (1.2e5 * WHEEL_TIME) - 20.0 * z.kappa * (np.abs(z.kappa) > 0.15),
            speed / RELAXATION * (f.slip - z.alpha),
            (np.array([f.ax, f.ay]) - z.felt) / LOAD_TIME,
        )
        return by, f


_NUMBERS = (
    "drag", "downforce", "brake_front", "engine_braking", "height", "roll_front", "grip", "stiffness", "sensitivity",
    "wind", "power", "lock", "wet_length", "wet_grip",
)  # fmt: skip


def _course(setup: Setup, rng: np.random.Generator) -> tuple[float | Array, ...]:
    """One car's road; on an oval the bank follows the curvature, on a road course it is waves."""
    length, curvature, x, y, heading = COURSES[setup.course](rng)
    wave = 2 * np.pi * np.arange(STATIONS) / STATIONS
    phase = rng.uniform(0, 2 * np.pi, 3)
    if setup.course == "oval":
        bank = -setup.bank * np.maximum(curvature / curvature.max(), 0.2 * (setup.bank > 0))
    else:
        bank = setup.bank * (0.6 * np.sin(3 * wave + phase[0]) + 0.4 * np.sin(4 * wave + phase[1]))
    grade = setup.grade * np.sin(2 * wave + phase[2])
    return length, curvature, x, y, heading, bank, grade, np.gradient(grade) / (length / STATIONS)
