"""Drives of random cars from 0.2 m to 4 m of wheelbase by the four-wheel physics of the simulated car.

Cars whose lengths are s times as long, times sqrt(s) and masses any, feel the same accelerations at the same slips
(Froude's similarity). So the physics, whose tyres have lengths and speeds of a full-size car in them, drives at full
size, and the log is that of a similar car of the size asked for. Real loggers do not scale: all write about 100 Hz.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import casadi as ca
import numpy as np

from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.plant.physics.dynamics import INPUTS, STATES, step_function
from hil_gateway.plant.physics.parameters import AV24, CarParameters
from hil_gateway.process.arrays import Array

STEP_S, STEPS = 0.001, 10
"""of the physics, and how many of them the driver holds his wheel and pedal"""
RATE_HZ = 100.0
SECONDS = 110.0
"""of the drive at full size"""
SPEED = (12.0 * GRAVITY * AV24.car.wheelbase) ** 0.5
"""m/s at full size"""
GEAR = 1.875 * 3.0
BRAKE_PA = 1e6
"""on the rear axle alone, as Eq. 2 has it, with the pedal down"""
SLALOM = 0.8, 0.35
"""shares of the lock in the slow and in the quick wave of the steering"""


@dataclass(frozen=True)
class SimilarCar:
    """One random car: `physics` at full size, its own `wheelbase` (m) and `mass` (kg)."""

    seed: int
    wheelbase: float
    mass: float

    @classmethod
    def random(cls, seed: int) -> SimilarCar:
        """Wheelbase 0.2 to 4 m and mass 2 kg to 3 t, spread evenly in their logarithms, heavier where longer."""
        share = float(np.random.default_rng([seed, 42]).uniform())
        return cls(seed, 0.2 * 20.0**share, 2.0 * 1500.0**share)

    @property
    def size(self) -> float:
        """Its lengths over those of the physics."""
        return self.wheelbase / AV24.car.wheelbase

    @property
    def physics(self) -> CarParameters:
        """At full size."""
        return _random(self.seed)

    @property
    def vehicle(self) -> dict[str, float]:
        """As a vehicle file declares it."""
        p, s = self.physics, self.size
        inertia = p.yaw_inertia / p.mass * s**2 * self.mass
        lengths = {n: s * getattr(p, n) for n in ("lf", "lr", "cg_height", "track_front", "track_rear", "wheel_radius")}
        return {"mass": self.mass, "yaw_inertia": inertia, **lengths}

    @property
    def stiffness(self) -> tuple[float, float, float]:
        """Of the front and rear axle over their loads, per rad, and of the rear axle along, N per unit slip."""
        p = self.physics
        along = p.bx * p.cx * p.dx * self.mass * GRAVITY * p.lf / p.wheelbase
        return p.bf * p.cf * p.df, p.br * p.cr * p.dr, along

    def log(self, *, every: int | None = None) -> dict[str, Array]:
        """Columns of its drive, with noise in proportion to its size; `every`: how many of the driver's steps a row."""
        times = self.size**0.5
        every = every or max(1, round(1.0 / (RATE_HZ * times * STEP_S * STEPS)))
        columns = {name: values[::every] for name, values in _driven(self.seed).items()}
        scales = {"t": times, "vx": times, "vy": times, "yaw_rate": 1.0 / times}
        rng, speed = np.random.default_rng([self.seed, 44]), SPEED
        noise = {"vx": 1e-3 * speed, "vy": 1e-3 * speed, "yaw_rate": 5e-4 * speed / AV24.car.wheelbase}
        noise |= {"ax": 0.1, "ay": 0.1, "drive": 3e-4}
        noisy = {n: c + noise.get(n, 0.0) * rng.standard_normal(len(c)) for n, c in columns.items()}
        return {name: scales.get(name, 1.0) * values for name, values in noisy.items()}


def _random(seed: int) -> CarParameters:
    """Weight distribution, gyration, height, tracks and tyres of its own; without air, rolling resistance and combined
    slip, which no tyre parameter stands for."""
    rng, base = np.random.default_rng([seed, 43]), AV24.car.wheelbase
    lf = base * rng.uniform(0.42, 0.58)
    front = rng.uniform(8.0, 13.0), rng.uniform(1.3, 1.6), rng.uniform(0.8, 1.6)
    stiffer, grippier = rng.uniform(1.05, 1.3), rng.uniform(1.05, 1.2)
    rear_c = rng.uniform(1.3, 1.6)
    rear_d = grippier * front[2]
    rear = stiffer * float(np.prod(front)) / (rear_c * rear_d), rear_c, rear_d
    return replace(
        AV24.car, lf=lf, lr=base - lf, yaw_inertia=AV24.car.mass * (base * rng.uniform(0.3, 0.5)) ** 2,
        cg_height=base * rng.uniform(0.06, 0.15), track_front=base * rng.uniform(0.45, 0.6),
        track_rear=base * rng.uniform(0.45, 0.6), downforce=0.0, drag=0.0, side=0.0, rolling_resistance=0.0,
        combined_slip=0.0, bf=front[0], cf=front[1], df=front[2],
        br=rear[0], cr=rear[1], dr=rear[2], load_sensitivity=rng.uniform(0.0, 0.12),
        relaxation_y=base * rng.uniform(0.02, 0.1),
    )  # fmt: skip


@cache
def _driven(seed: int) -> dict[str, Array]:
    """A slalom that grows to the limit of grip, at full size and without noise, a row a step of the driver."""
    p, speed, base = _random(seed), SPEED, AV24.car.wheelbase
    t = np.arange(0.0, SECONDS, STEP_S * STEPS)
    slow, quick = 0.25 * speed / base / 12.0, 0.7 * speed / base / 12.0
    lock = 0.35 * GRAVITY * base / speed**2 + 0.08 * p.df
    shares = SLALOM[0] * np.sin(slow * t), SLALOM[1] * np.sin(quick * t + 0.5)
    steer = lock * (0.25 + 0.75 * t / SECONDS) * (shares[0] + shares[1])
    wanted = speed * (0.85 + 0.1 * np.sin(0.37 * slow * t) + 0.06 * np.sin(2.3 * quick * t))
    at = {name: i for i, name in enumerate(STATES)}
    state = np.zeros(len(STATES))
    state[at["vx"]] = wanted[0]
    state[[at[f"spin_{wheel}"] for wheel in ("fl", "fr", "rl", "rr")]] = wanted[0] / p.wheel_radius
    rows, forces = np.empty((len(t), len(STATES))), np.empty((len(t), 2))
    several, vector = step_function().mapaccum(STEPS), ca.repmat(ca.DM(p.vector()), 1, STEPS)
    inputs = np.zeros(len(INPUTS))
    inputs[[INPUTS.index(n) for n in ("ratio", "engine_running", "gravity_z", "grip")]] = GEAR, 1.0, GRAVITY, 1.0
    pressed = [INPUTS.index(f"{name}_command") for name in ("steer", "throttle", "brake_rear")]
    for i in range(len(t)):
        pedal = 0.6 * (wanted[i] - state[at["vx"]]) + 0.15
        inputs[pressed] = steer[i], np.clip(pedal, 0.0, 1.0), BRAKE_PA * np.clip(-pedal, 0.0, 1.0)
        after, outputs = several(state, ca.repmat(ca.DM(inputs), 1, STEPS), vector, STEP_S)
        rows[i], forces[i] = state, np.asarray(outputs)[:2, 0]
        state = np.asarray(after)[:, -1]
    columns = {name: rows[:, at[name]] for name in ("vx", "vy", "yaw_rate", "steer")}
    rim = p.wheel_radius * (rows[:, at["spin_rl"]] + rows[:, at["spin_rr"]]) / 2.0
    return {"t": t, **columns, "ax": forces[:, 0], "ay": forces[:, 1], "drive": rim / rows[:, at["vx"]] - 1.0}
