"""Drives of cars of any size, by equations of their own: Eq. 1-3 of the paper in plain numpy, and a slalom driver."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hil_gateway.process.arrays import Array

GRAVITY = 9.80665


@dataclass(frozen=True)
class AnyCar:
    """A single-track car, SI; tyres by (B, C, D) an axle and C_x in weights per unit slip."""

    mass: float
    wheelbase: float
    front_share: float = 0.45
    """of the wheelbase, from the centre of gravity to the front axle"""
    gyration: float = 0.4
    """over the wheelbase"""
    front: tuple[float, float, float] = (11.0, 1.5, 1.5)
    rear: tuple[float, float, float] = (12.5, 1.55, 1.5)
    slip_stiffness: float = 7.0

    @property
    def vehicle(self) -> dict[str, float]:
        """As a vehicle file declares it."""
        lf = self.front_share * self.wheelbase
        inertia = self.mass * (self.gyration * self.wheelbase) ** 2
        return {"mass": self.mass, "yaw_inertia": inertia, "lf": lf, "lr": self.wheelbase - lf}

    def drive(self, seed: int, seconds: float = 120.0, rate: float = 100.0) -> dict[str, Array]:
        """A slalom that grows to the limit of grip, at speeds and with noise in proportion to the car's size."""
        rng, step = np.random.default_rng(seed), 1.0 / rate
        speed, base = np.sqrt(12.0 * GRAVITY * self.wheelbase), self.wheelbase
        t = np.arange(0.0, seconds, step)
        slow, quick = 0.25 * speed / base / 12.0, 0.7 * speed / base / 12.0
        lock = 0.35 * GRAVITY * base / speed**2 + 0.09
        steer = lock * (0.25 + 0.75 * t / seconds) * (0.8 * np.sin(slow * t) + 0.35 * np.sin(quick * t + 0.5))
        wanted = speed * (0.85 + 0.15 * np.sin(0.37 * slow * t))
        states, forces, drive = self._simulate(steer, wanted, step, speed)
        columns = {"t": t, "vx": states[0], "vy": states[1], "yaw_rate": states[2], "ax": forces[0], "ay": forces[1]}
        noise = {"vx": 1e-3 * speed, "vy": 1e-3 * speed, "yaw_rate": 2e-3 * speed / base / 4.0, "ax": 0.1, "ay": 0.1}
        noisy = {n: c + noise.get(n, 0.0) * rng.standard_normal(len(t)) for n, c in columns.items()}
        return {**noisy, "steer": steer, "drive": drive}

    def _simulate(self, steer: Array, wanted: Array, step: float, speed: float) -> tuple[Array, Array, Array]:
        n = len(steer)
        states, forces, drive = np.empty((3, n)), np.empty((2, n)), np.empty(n)
        state = np.array([wanted[0], 0.0, 0.0])
        inner = max(1, int(np.ceil(step * 200.0 * np.sqrt(GRAVITY / self.wheelbase) / 10.0)))
        for i in range(n):
            drive[i] = np.clip(0.3 * (wanted[i] - state[0]) / speed, -0.06, 0.06)
            forces[:, i] = self._rates(state, steer[i], drive[i])[1]
            states[:, i] = state
            for _ in range(inner):
                state = self._next(state, steer[i], drive[i], step / inner)
        return states, forces, drive

    def _next(self, state: Array, steer: float, drive: float, step: float) -> Array:
        """One step of Runge and Kutta."""
        k1 = self._rates(state, steer, drive)[0]
        k2 = self._rates(state + 0.5 * step * k1, steer, drive)[0]
        k3 = self._rates(state + 0.5 * step * k2, steer, drive)[0]
        k4 = self._rates(state + step * k3, steer, drive)[0]
        return np.asarray(state + step / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4))

    def _rates(self, state: Array, steer: float, drive: float) -> tuple[Array, Array]:
        """Derivatives of vx, vy, yaw rate; and ax, ay, by masses of one."""
        vx, vy, rate = state
        base, lf = self.wheelbase, self.front_share * self.wheelbase
        lr = base - lf
        slips = steer - np.arctan2(vy + lf * rate, vx), -np.arctan2(vy - lr * rate, vx)
        loads = GRAVITY * lr / base, GRAVITY * lf / base
        side = [
            d * load * np.sin(c * np.arctan(b * slip))
            for slip, load, (b, c, d) in zip(slips, loads, (self.front, self.rear), strict=True)
        ]
        push = self.slip_stiffness * GRAVITY * drive
        ax = push - side[0] * np.sin(steer)
        ay = side[1] + side[0] * np.cos(steer)
        turn = (side[0] * np.cos(steer) * lf - side[1] * lr) / (self.gyration * base) ** 2
        return np.array([ax + vy * rate, ay - vx * rate, turn]), np.array([ax, ay])
