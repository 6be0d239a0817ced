"""Drives simulated by code of its own: Eq. 1-3 in plain numpy, many cars side by side; nothing of the product."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hil_gateway.process.arrays import Array

MASS, INERTIA, LF, LR, G = 787.3, 1000.0, 1.724, 1.248, 9.80665
LOAD_F, LOAD_R = MASS * G * LR / (LF + LR), MASS * G * LF / (LF + LR)
SUBSTEPS = 2
RATE_HZ = 100
NOISE = {"vx": 0.02, "vy": 0.02, "yaw_rate": 0.003, "ax": 0.15, "ay": 0.15, "yaw": 0.001}
TYRE = {"cx": 62000.0, "bf": 11.5, "cf": 1.55, "df": 1.6, "br": 13.0, "cr": 1.6, "dr": 1.58}


@dataclass(frozen=True)
class Drive:
    """One simulated log: noisy columns, and the tyre it was driven on."""

    columns: dict[str, Array]
    tyre: dict[str, float]


def accelerations(state: Array, steer: Array, drive: Array, tyre: dict[str, Array]) -> tuple[Array, Array, Array]:
    """(ax, ay, yaw acceleration) of Eq. 1-3 for states (3, cars): vx, vy, yaw rate."""
    vx, vy, yaw_rate = state
    front = steer - np.arctan((vy + LF * yaw_rate) / vx)
    rear = -np.arctan((vy - LR * yaw_rate) / vx)
    fyf = tyre["df"] * LOAD_F * np.sin(tyre["cf"] * np.arctan(tyre["bf"] * front))
    fyr = tyre["dr"] * LOAD_R * np.sin(tyre["cr"] * np.arctan(tyre["br"] * rear))
    ax = (tyre["cx"] * drive - fyf * np.sin(steer)) / MASS
    ay = (fyr + fyf * np.cos(steer)) / MASS
    return ax, ay, (fyf * LF * np.cos(steer) - fyr * LR) / INERTIA


def _rates(state: Array, steer: Array, drive: Array, tyre: dict[str, Array]) -> Array:
    ax, ay, yaw_acc = accelerations(state, steer, drive, tyre)
    return np.stack([ax + state[1] * state[2], ay - state[0] * state[2], yaw_acc])


def simulate(tyres: list[dict[str, float]], seconds: float, seed: int, noise: float = 1.0) -> list[Drive]:
    """One drive per tyre: ever harder cornering at varying speed, sampled at 100 Hz with sensor noise."""
    rng = np.random.default_rng(seed)
    cars, steps = len(tyres), round(seconds * RATE_HZ)
    tyre = {name: np.array([t[name] for t in tyres]) for name in TYRE}
    t = np.arange(steps) / RATE_HZ
    speed, cornering = _demands(rng, t, cars)
    state = np.stack([speed[0], np.zeros(cars), np.zeros(cars)])
    steer, drive, yaw = np.zeros(cars), np.zeros(cars), np.zeros(cars)
    out = {name: np.empty((steps, cars)) for name in ("vx", "vy", "yaw_rate", "ax", "ay", "steer", "drive", "yaw")}
    h = 1.0 / (RATE_HZ * SUBSTEPS)
    for k in range(steps):
        wanted = (LF + LR) * cornering[k] / state[0] ** 2 + 0.3 * (cornering[k] / state[0] - state[2])
        drive_wanted = np.clip(0.03 * (speed[k] - state[0]), -0.08, 0.08)
        ax, ay, _ = accelerations(state, steer, drive, tyre)
        row = (*state, ax, ay, steer, drive, yaw)
        for name, values in zip(out, row, strict=True):
            out[name][k] = values
        for _ in range(SUBSTEPS):
            steer = steer + np.clip(wanted - steer, -0.9 * h, 0.9 * h)
            drive = drive + np.clip(drive_wanted - drive, -0.6 * h, 0.6 * h)
            middle = state + 0.5 * h * _rates(state, steer, drive, tyre)
            state = state + h * _rates(middle, steer, drive, tyre)
            yaw = yaw + h * state[2]
    return [_recorded(rng, t, out, i, tyres[i], noise) for i in range(cars)]


def _demands(rng: np.random.Generator, t: Array, cars: int) -> tuple[Array, Array]:
    """Speed (steps, cars), m/s, and lateral acceleration demanded, m/s2, growing from gentle to hard."""
    frequency = rng.uniform(0.04, 0.25, (12, 1, cars))
    waves = np.sin(2 * np.pi * (frequency * t[:, None] + rng.uniform(0, 1, (12, 1, cars))))
    speed = 38.0 + 12.0 * waves[:4].mean(axis=0) * 2.0
    growth = 5.0 + 7.5 * t[:, None] / t[-1]
    return speed, growth * np.tanh(waves[4:].sum(axis=0) / 1.5)


def _recorded(  # noqa: PLR0917 - what a recorder needs
    rng: np.random.Generator, t: Array, out: dict[str, Array], car: int, tyre: dict[str, float], noise: float
) -> Drive:
    columns = {"t": t}
    for name, values in out.items():
        columns[name] = values[:, car] + noise * NOISE.get(name, 0.0) * rng.standard_normal(len(t))
    return Drive(columns, tyre)


def random_tyres(count: int, seed: int) -> list[dict[str, float]]:
    """Tyres around `TYRE`, each parameter within 15 %."""
    rng = np.random.default_rng(seed)
    return [{name: value * rng.uniform(0.85, 1.15) for name, value in TYRE.items()} for _ in range(count)]


def to_csv(columns: dict[str, Array]) -> str:
    """The drive log as a CSV file's text."""
    rows = np.stack(list(columns.values()), axis=1)
    return ",".join(columns) + "\n" + "\n".join(",".join(f"{v:.9g}" for v in row) for row in rows) + "\n"
