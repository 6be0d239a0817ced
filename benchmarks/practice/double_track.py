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

from .drive import COURSES, STATIONS, Drive

GRAVITY = 9.80665
MASS, INERTIA, LF, LR, TRACK_F, TRACK_R = 787.0, 1000.0, 1.7238, 1.248, 1.638, 1.523
WHEELBASE = LF + LR
PLACE = np.array([[LF, LF, -LR, -LR], [TRACK_F / 2, -TRACK_F / 2, TRACK_R / 2, -TRACK_R / 2]])
"""x and y of the wheels, m"""
STATIC = MASS * GRAVITY / (2 * WHEELBASE) * np.array([LR, LR, LF, LF])
"""load of each wheel at rest, N"""
NOISE = {
    "x": 0.02, "y": 0.02, "yaw": 0.001, "vx": 0.02, "vy": 0.02, "yaw_rate": 0.002, "ax": 0.12, "ay": 0.12,
    **{f"wheel_speed_{wheel}": 0.03 for wheel in ("fl", "fr", "rl", "rr")},
}  # fmt: skip
WHEEL_TIME, LOAD_TIME, RELAXATION = 0.015, 0.12, 0.25
"""s, s and m: slip ratios follow the torque, loads the acceleration, slip angles the way travelled"""
STEP, LOG_EVERY = 0.005, 2
STEER_MAX, BRAKE_PRESSURE = 0.2, 1.5e6
"""rad; Pa of a full brake pedal"""
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
        wind: m/s; wet: laps in which a tenth of the lap has 0.7 of the grip.
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
    fastest: float = 60.0
    power: float = 345e3
    lock: float = 0.25


class Course(NamedTuple):
    """The road of every car on equal stations (drives, STATIONS): see `Track` and Frenet coordinates."""

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
        return np.maximum(
            STATIC[:, None] * normal / GRAVITY + air + along + np.array([-front, front, -rear, rear]), 50.0
        )

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
        there = self.wet[self.rows, np.minimum(lap, self.wet.shape[1] - 1)] & (np.abs(place - self.wet_at) < 0.05)
        return np.where(there, 0.7, 1.0)

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
    "wind", "power", "lock",
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


def _references(car: DoubleTrack, laps: int) -> Array:
    """(laps, n, STATIONS) speeds, from gentle to `Setup.pace` of what the tyres can give."""
    c, ds = car.course, (car.course.length / STATIONS)
    profiles = []
    for share in np.linspace(0.35, 1.0, laps):
        use = np.array([share * s.pace for s in car.setups])[:, None]
        grip = use * car.of["grip"].min(axis=0)[:, None]
        lift = car.of["downforce"].sum(axis=0)[:, None] / MASS
        kappa = np.maximum(np.abs(c.curvature), 1e-4)
        tilt = -np.sin(c.bank) * np.sign(c.curvature)
        left = np.maximum(kappa * (1 - grip * tilt) - 0.8 * grip * lift, 1e-4)
        cap = np.array([s.fastest * (0.6 + 0.4 * share) for s in car.setups])[:, None]
        v = np.minimum(np.sqrt(GRAVITY * (grip + tilt) / left), cap)
        faster, slower = 2 * 4.0 * ds * use[:, 0], 2 * 8.0 * ds * use[:, 0]
        for _ in range(2):
            for i in range(STATIONS):
                v[:, i] = np.minimum(v[:, i], np.sqrt(v[:, i - 1] ** 2 + faster))
            for i in range(STATIONS - 1, -1, -1):
                v[:, i] = np.minimum(v[:, i], np.sqrt(v[:, (i + 1) % STATIONS] ** 2 + slower))
        profiles.append(v)
    return np.array(profiles)


def _driven(car: DoubleTrack, z: State, before: Pedals, reference: Array, tick: int) -> Pedals:
    """The driver: curvature and speed ahead, offset and heading error; pedals and steering at bounded rates."""
    rows, c = car.rows, car.course
    at = ((z.share % 1.0 + 0.2 * z.vx / c.length) * STATIONS).astype(int) % STATIONS
    lap = np.minimum(z.share.astype(int), len(reference) - 1)
    kappa, target = c.curvature[rows, at], reference[lap, rows, at]
    steer = kappa * (WHEELBASE + 0.0008 * z.vx**2) - 0.01 * z.offset - (0.2 + 1.0 / z.vx) * z.mu
    steer = steer - 0.03 * (z.rate - kappa * z.vx) + 0.08 / z.vx * np.sin(2 * np.pi * 0.9 * tick * STEP)
    most = 0.8 * STEP
    steer = before.steer + np.clip(np.clip(steer, -STEER_MAX, STEER_MAX) - before.steer, -most, most)
    wanted = 1.5 * (target - z.vx)
    throttle = np.clip(wanted / 6.0, 0.0, 1.0)
    brake = np.clip(-(wanted + 1.0) / 14.0, 0.0, 1.0)
    most = 4.0 * STEP
    return Pedals(
        steer, before.throttle + np.clip(throttle - before.throttle, -most, most),
        before.brake + np.clip(brake - before.brake, -most, most),
    )  # fmt: skip


def simulate(setups: Sequence[Setup], seeds: Sequence[int]) -> list[Drive]:
    """Drive every car for its laps; all have as many, and those that leave the road by 15 m end there."""
    car, n = DoubleTrack(setups, seeds), len(setups)
    laps = setups[0].laps
    reference = _references(car, laps)
    zero = np.zeros(n)
    z = State(
        zero, zero, zero, car.course.heading[:, 0], np.minimum(reference[0][:, 0], 25.0), zero, zero,
        np.zeros((4, n)), np.zeros((4, n)), np.zeros((2, n)),
    )  # fmt: skip
    x, y, pedals, tick, log = car.course.x[:, 0].copy(), car.course.y[:, 0].copy(), Pedals(zero, zero, zero), 0, []
    while np.min(z.share) < laps and tick * STEP < 1500.0:
        pedals = _driven(car, z, pedals, reference, tick)
        first, f = car.rates(z, pedals)
        if tick % LOG_EVERY == 0:
            log.append(_row(z, x, y, f, pedals))
        second, _ = car.rates(z.moved(first, STEP), pedals)
        course = z.yaw + 0.5 * STEP * z.rate
        x = x + STEP * (z.vx * np.cos(course) - z.vy * np.sin(course))
        y = y + STEP * (z.vx * np.sin(course) + z.vy * np.cos(course))
        z = z.moved(first, STEP / 2).moved(second, STEP / 2)
        tick += 1
    raw = {name: np.array([row[name] for row in log]) for name in log[0]}
    return [_logged({k: v[:, i] for k, v in raw.items()}, seed, laps) for i, seed in enumerate(seeds)]


def _row(z: State, x: Array, y: Array, f: Forces, pedals: Pedals) -> dict[str, Array]:
    """What sensors without errors would report."""
    wheels = {
        f"wheel_speed_{name}": (z.vx - z.rate * PLACE[1][i]) * (1 + z.kappa[i])
        for i, name in enumerate(("fl", "fr", "rl", "rr"))
    }
    return {
        "x": x, "y": y, "yaw": z.yaw, "vx": z.vx, "vy": z.vy, "yaw_rate": z.rate, "ax": f.ax, "ay": f.ay,
        "steer": pedals.steer, "throttle": pedals.throttle, "brake": BRAKE_PRESSURE * pedals.brake, **wheels,
        "lap": z.share.astype(int).astype(float), "offset": z.offset,
    }  # fmt: skip


def _logged(columns: dict[str, Array], seed: int, laps: int) -> Drive:
    """What the sensors of one drive report, up to where it ends or leaves the road."""
    rng = np.random.default_rng([seed, 77])
    ended = (columns["lap"] >= laps) | (np.abs(columns.pop("offset")) > 15.0)
    stop = int(np.argmax(ended)) or len(ended)
    columns = {name: values[:stop] for name, values in columns.items()}
    for name, std in NOISE.items():
        columns[name] = columns[name] + std * rng.normal(size=stop)
    rear = (columns["wheel_speed_rl"] + columns["wheel_speed_rr"]) / 2
    columns["drive"] = rear / columns["vx"] - 1.0
    return Drive({"t": np.arange(stop) * STEP * LOG_EVERY} | columns, {}, seed, {})
