"""The practice car: the paper's Eq. 1-3 with per-axle tyres, and every undeclared effect as a size.

An id may have variants, `id/variant`: the same physics in another shape than the catalogue's, since a real car
does not read the catalogue either.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from hil_gateway.process.arrays import Array

from . import outside
from .outside import Local, Motion

GRAVITY = 9.80665
TYRE = {"cx": 62000.0, "bf": 11.5, "cf": 1.55, "df": 1.6033, "br": 13.0, "cr": 1.6, "dr": 1.5847}
WARM_UP_S = 200.0

# id -> a typical range of sizes, drawn with either sign where `signed`
SIZES: dict[str, tuple[float, float, bool]] = {
    "aero_drag": (0.3, 1.0, False),
    "rolling_resistance": (150.0, 500.0, False),
    "road_grade": (0.02, 0.06, False),
    "road_bank": (0.02, 0.08, False),
    "aero_downforce": (0.5, 2.0, False),
    "load_transfer": (0.2, 0.5, False),
    "load_sensitivity": (0.15, 0.4, False),
    "combined_slip": (0.6, 1.1, False),
    "drive_saturation": (4500.0, 8000.0, False),
    "front_brake": (0.3, 0.6, False),
    "engine_braking": (150.0, 600.0, False),
    "steer_offset": (0.003, 0.01, True),
    "steer_scale": (0.05, 0.12, True),
    "steer_delay": (0.03, 0.1, False),
    "steer_play": (0.004, 0.01, False),
    "drive_delay": (0.05, 0.2, False),
    "tyre_relaxation": (0.3, 1.0, False),
    "grip_drift": (1e-4, 2.5e-4, True),
    "imu_misalignment": (0.015, 0.05, True),
    "imu_lever_arm": (0.4, 1.2, True),
    "imu_bias": (0.1, 0.4, True),
    "speed_scale": (0.02, 0.06, True),
    "wind": (4.0, 12.0, False),
    "yaw_damping": (500.0, 2500.0, False),
    "turn_asymmetry": (0.04, 0.12, True),
    # the same in other shapes
    "drive_saturation/magic": (4500.0, 8000.0, False),
    "combined_slip/quadratic": (0.5, 1.0, False),
    "combined_slip/slip": (6.0, 12.0, False),
    "engine_braking/speed": (150.0, 600.0, False),
    "engine_braking/coast": (300.0, 800.0, False),
    "steer_delay/lag": (0.03, 0.1, False),
    "drive_delay/lag": (0.05, 0.2, False),
    "grip_drift/warmup": (0.06, 0.15, True),
    "imu_lever_arm/y": (0.3, 0.8, True),
    "imu_bias/yaw_rate": (0.005, 0.02, True),
    "speed_scale/both": (0.02, 0.06, True),
    "wind/drag_only": (5.0, 12.0, False),
    "turn_asymmetry/steer": (0.03, 0.08, True),
    "steer_play/dahl": (0.004, 0.01, False),
    "front_brake/valve": (0.4, 0.7, False),
    "load_transfer/slow": (0.25, 0.5, False),
    "wind/turning": (5.0, 12.0, False),
}

SIZES |= {name: sizes for name, (sizes, _, _) in outside.EFFECTS.items()}
OUTSIDE = {name: (channels, signals) for name, (_, channels, signals) in outside.EFFECTS.items()}
"""effect outside the catalogue -> channels and signals either of which is a right answer"""


def draw_size(name: str, rng: np.random.Generator) -> float:
    """A size of effect `name` that a race engineer would call sensible."""
    low, high, signed = SIZES[name]
    size = float(rng.uniform(low, high))
    return -size if signed and rng.random() < 0.5 else size


@dataclass(frozen=True)
class Chassis:
    """What a vehicle file declares of a car, SI, and its tyres."""

    mass: float = 787.3
    inertia: float = 1000.0
    lf: float = 1.724
    lr: float = 1.248
    tyre: Mapping[str, float] = field(default_factory=lambda: dict(TYRE))


class Car:
    """Forces of many cars at once; every effect is a column of sizes, zero (or one) where it is off."""

    def __init__(
        self, effects: Sequence[Mapping[str, float]], seeds: Sequence[int], chassis: Sequence[Chassis] = ()
    ) -> None:
        each = chassis or [Chassis()] * len(seeds)
        self.mass, self.inertia, self.lf, self.lr = (
            np.array([getattr(one, name) for one in each]) for name in ("mass", "inertia", "lf", "lr")
        )
        self.wheelbase = self.lf + self.lr
        self.tyre = {name: np.array([one.tyre[name] for one in each]) for name in TYRE}
        self.size = {name: np.array([e.get(name, 0.0) for e in effects]) for name in SIZES}
        drawn = np.array([np.random.default_rng([seed, 5]).uniform(size=8) for seed in seeds]).T
        self.phase, self.wind_from = 2 * np.pi * drawn[:4], 2 * np.pi * drawn[4]
        self.local = Local(0.1 + 0.5 * drawn[5], 900.0 * (0.3 + 0.2 * drawn[6]))
        self.axis = (drawn[7] > 0.5).astype(int)
        weight = self.mass * GRAVITY
        self.front, self.rear = weight * self.lr / self.wheelbase, weight * self.lf / self.wheelbase
        self.fmax, self.fmagic = (
            np.where(self.size[name] > 0, self.size[name], 1e9)
            for name in ("drive_saturation", "drive_saturation/magic")
        )

    def grade(self, lap_share: Array) -> tuple[Array, Array]:
        """Grade and bank, rad, at a share of the lap."""
        wave = 2 * np.pi * lap_share
        p = self.phase
        grade = 0.7 * np.sin(2 * wave + p[0]) + 0.3 * np.sin(5 * wave + p[1])
        bank = 0.6 * np.sin(3 * wave + p[2]) + 0.4 * np.sin(4 * wave + p[3])
        return self.size["road_grade"] * grade, self.size["road_bank"] * bank

    def slips(self, vx: Array, vy: Array, rate: Array, steer: Array) -> tuple[Array, Array]:
        """Slip angles, Eq. (3)."""
        behind = outside.steered_behind(self.size, vx, rate)
        return steer - np.arctan2(vy + self.lf * rate, vx), behind - np.arctan2(vy - self.lr * rate, vx)

    def longitudinal(self, at: Motion) -> tuple[Array, Array, Array]:
        """Longitudinal force of front and rear tyres and on the body, N."""
        s, vx, drive, cx = self.size, at.vx, at.drive, self.tyre["cx"]
        valve = s["front_brake/valve"] * np.minimum(-drive / 0.06, 1.0)
        front_x = (s["front_brake"] + valve) * np.minimum(drive, 0.0) * cx
        rear_x = cx * outside.driven(s, at, self.local) - front_x
        rear_x = rear_x - (s["engine_braking"] + s["engine_braking/speed"] * vx / 30.0) * (drive <= 0)
        rear_x = rear_x - s["engine_braking/coast"] * (np.abs(drive) < 0.0012)
        rear_x = self.fmax * np.tanh(rear_x / self.fmax)
        rear_x = self.fmagic * np.sin(1.5 * np.arctan(rear_x / (1.5 * self.fmagic)))
        against = self._into_wind(at)
        wind = s["wind"] + s["wind/drag_only"] + s["wind/turning"]
        air_x = vx - wind * np.cos(against)
        body_x = -s["aero_drag"] * vx * vx - s["rolling_resistance"] - 0.516 * (air_x * np.abs(air_x) - vx * vx)
        return front_x, rear_x, body_x + outside.forward_force(s, at, self.local)

    def _into_wind(self, at: Motion) -> Array:
        """Angle, rad, of the car from where the wind comes, which turns by a radian in five minutes."""
        turned = np.where(self.size["wind/turning"] > 0, at.t / 300.0, 0.0)
        return np.asarray(at.yaw - self.wind_from - turned)

    def peaks(self, at: Motion, slip: tuple[Array, Array]) -> tuple[Array, Array]:
        """D F_z of both axles, N."""
        s, t, vx = self.size, at.t, at.vx
        transfer = s["load_transfer"] * self.mass * at.ax_before / self.wheelbase
        transfer = transfer + s["load_transfer/slow"] * self.mass * at.ax_slow / self.wheelbase
        down = s["aero_downforce"] * vx * vx
        fz_f, fz_r = self.front + 0.4 * down - transfer, self.rear + 0.6 * down + transfer
        grip = 1 + s["grip_drift"] * t + s["grip_drift/warmup"] * (1 - np.exp(-t / WARM_UP_S))
        grip_f, grip_r = (grip * g for g in outside.grip(s, at, self.local))
        left = [1 + s["turn_asymmetry"] * np.sign(alpha) for alpha in slip]
        d_f = self.tyre["df"] * (1 - s["load_sensitivity"] * (fz_f / self.front - 1)) * grip_f * left[0]
        d_r = self.tyre["dr"] * (1 - s["load_sensitivity"] * (fz_r / self.rear - 1)) * grip_r * left[1]
        lighter = outside.mass(s, at)
        return d_f * fz_f * lighter, d_r * fz_r * lighter

    def left_over(self, force: Array, peak: Array, drive: Array) -> Array:
        """Share of the lateral force that a longitudinal one leaves."""
        s, used = self.size, force / peak
        ellipse = np.sqrt(np.maximum(1 - (s["combined_slip"] * used) ** 2, 0.05))
        quadratic = 1 - s["combined_slip/quadratic"] * used**2
        return np.asarray(ellipse * quadratic * np.cos(np.arctan(s["combined_slip/slip"] * drive)))

    def accelerations(self, at: Motion, slip: tuple[Array, Array]) -> tuple[Array, ...]:
        """Specific forces, yaw acceleration, d/dt vx and d/dt vy of every car."""
        s, vx, vy, rate = self.size, at.vx, at.vy, at.rate
        front_x, rear_x, body_x = self.longitudinal(at)
        peak_f, peak_r = self.peaks(at, slip)
        curve_f, curve_r = (
            np.sin(self.tyre[f"c{axle}"] * np.arctan(self.tyre[f"b{axle}"] * outside.stiffness(s, at) * alpha))
            for axle, alpha in zip("fr", slip, strict=True)
        )
        fy_f = peak_f * curve_f * self.left_over(front_x, peak_f, 0 * vx)
        fy_r = peak_r * curve_r * self.left_over(rear_x, peak_r, at.drive)
        blown = s["wind"] + s["wind/turning"]
        body_y = 0.7 * blown * np.sin(-self._into_wind(at)) * vx + outside.side_force(s, at, self.local)
        sin, cos = np.sin(at.steer), np.cos(at.steer)
        moment = -s["yaw_damping"] * rate + outside.moment(s, at, self.local)
        mass = self.mass * outside.mass(s, at)
        ax = (rear_x + front_x * cos - fy_f * sin + body_x) / mass
        ay = (fy_r + fy_f * cos + front_x * sin + body_y) / mass
        yaw_acc = ((fy_f * cos + front_x * sin) * self.lf - fy_r * self.lr + moment) / self.inertia
        grade, bank = self.grade(at.share)
        vx_dot = ax + vy * rate - GRAVITY * np.sin(grade)
        vy_dot = ay - vx * rate - GRAVITY * np.sin(bank)
        return ax, ay, yaw_acc, vx_dot, vy_dot

    def true_steer(self, reported: Array, vx: Array, rate: Array, drive: Array) -> Array:
        """Road-wheel angle behind the reported one (delay and play are applied by the caller)."""
        s = self.size
        steer = reported * (1 + s["steer_scale"] + s["turn_asymmetry/steer"] * np.sign(reported)) + s["steer_offset"]
        return outside.steered(s, steer, vx, rate, drive)
