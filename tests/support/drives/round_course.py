"""Laps of a small car with its own equations on a made-up course: seconds of work, for decisions on recorded laps.

A bicycle with one friction curve an axle and quadratic drag, integrated by Euler's method at 200 Hz; nothing of it is
the estimator's.
"""

from __future__ import annotations

from math import atan, atan2, cos, hypot, pi, sin
from pathlib import Path

import numpy as np

from hil_gateway.car.car import load_car
from hil_gateway.car.vehicle import GRAVITY, Vehicle

RADIUS, WAVES, DEPTH, POINTS = 110.0, 3, 20.0, 300
"""m, 1, m: a round course with three bays, so that it turns both ways"""
STEP, LOG_EVERY = 0.005, 4
"""s; every so many steps a row, 50 Hz"""
TYRE = {"cx": 50000.0, "bf": 9.0, "cf": 1.35, "df": 1.3567, "br": 10.0, "cr": 1.4, "dr": 1.3392}
NOISE = {"vx": 0.02, "vy": 0.01, "yaw_rate": 0.001, "ax": 0.05, "ay": 0.05}
WEAVE = 0.006, 7.0
"""rad, rad/s: what the driver steers beside the line, to show the tyres"""


def course() -> list[tuple[float, float]]:
    """Centre line, counter-clockwise, m."""
    turns = (2 * pi * i / POINTS for i in range(POINTS))
    polar = ((RADIUS + DEPTH * cos(WAVES * turn), turn) for turn in turns)
    return [(radius * cos(turn), radius * sin(turn)) for radius, turn in polar]


def write_course(path: Path) -> Path:
    """The course as a track file, 6 m to either edge."""
    path.write_text("\n".join(["x_m,y_m,w_tr_right_m,w_tr_left_m", *(f"{x:.4f},{y:.4f},6,6" for x, y in course())]))
    return path


def laps_of(drag: float, laps: int, seed: int = 1) -> dict[str, np.ndarray]:
    """Drive-log columns, as the learner's collector has them, of a car with `drag` (N s2/m2)."""
    line, v = course(), load_car().vehicle
    (x, y), yaw, vx, vy, rate, steer, drive = line[0], 0.5 * pi, 18.0, 0.0, 0.0, 0.0, 0.02
    rows, lap, nearest, tick = [], 0, 0, 0
    while lap < laps:
        t = tick * STEP
        following = (nearest + 1) % POINTS
        if hypot(line[following][0] - x, line[following][1] - y) < hypot(line[nearest][0] - x, line[nearest][1] - y):
            nearest, lap = following, lap + (following == 0)
        target = line[(nearest + 5) % POINTS]
        bearing = (atan2(target[1] - y, target[0] - x) - yaw + pi) % (2 * pi) - pi
        bend = 2 * sin(bearing) / hypot(target[0] - x, target[1] - y)
        wanted = bend * v.wheelbase + WEAVE[0] * sin(WEAVE[1] * t)
        steer += _within(wanted - steer, STEP)
        drive += _within(_within(0.02 * (21.0 + 4.0 * sin(0.7 * t) - vx), 0.06) - drive, 0.4 * STEP)
        ax, ay, turning = _forces(v, drag, (vx, vy, rate), steer, drive)
        if tick % LOG_EVERY == 0:
            rows.append((t, x, y, yaw, vx, vy, rate, ax, ay, steer, drive, lap))
        vx, vy, rate = vx + STEP * (ax + vy * rate), vy + STEP * (ay - vx * rate), rate + STEP * turning
        x, y = x + STEP * (vx * cos(yaw) - vy * sin(yaw)), y + STEP * (vx * sin(yaw) + vy * cos(yaw))
        yaw, tick = yaw + STEP * rate, tick + 1
    return _logged(np.array(rows), np.random.default_rng(seed))


def _within(value: float, most: float) -> float:
    return max(-most, min(most, value))


def _forces(
    v: Vehicle, drag: float, motion: tuple[float, float, float], steer: float, drive: float
) -> tuple[float, float, float]:
    """Specific forces, m/s2, and yaw acceleration, rad/s2."""
    vx, vy, rate = motion
    front, rear = steer - atan2(vy + v.lf * rate, vx), -atan2(vy - v.lr * rate, vx)
    weight = v.mass * GRAVITY / v.wheelbase
    across_f = weight * v.lr * TYRE["df"] * sin(TYRE["cf"] * atan(TYRE["bf"] * front))
    across_r = weight * v.lf * TYRE["dr"] * sin(TYRE["cr"] * atan(TYRE["br"] * rear))
    along = TYRE["cx"] * drive - drag * vx * vx - across_f * sin(steer)
    turned = across_f * cos(steer)
    return along / v.mass, (turned + across_r) / v.mass, (turned * v.lf - across_r * v.lr) / v.yaw_inertia


def _logged(rows: np.ndarray, rng: np.random.Generator) -> dict[str, np.ndarray]:
    names = ("t", "x", "y", "yaw", "vx", "vy", "yaw_rate", "ax", "ay", "steer", "drive", "lap")
    columns = dict(zip(names, rows.T, strict=True))
    for name, std in NOISE.items():
        columns[name] = columns[name] + rng.normal(0.0, std, len(rows))
    names = ("throttle", "brake", "brake_balance", "gear", "engine_speed", "extra_load")
    still = dict.fromkeys(names, np.zeros(len(rows)))
    spread = {f"std_{name}": np.full(len(rows), NOISE[name]) for name in ("vx", "vy", "yaw_rate")}
    return {**columns, **still, **spread}
