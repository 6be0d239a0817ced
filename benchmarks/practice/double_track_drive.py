"""Drives of double-track cars: the driver, laps from gentle to hard, and what the sensors report."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hil_gateway.process.arrays import Array

from .double_track import BRAKE_PRESSURE, GRAVITY, MASS, PLACE, WHEELBASE, DoubleTrack, Forces, Pedals, Setup, State
from .drive import STATIONS, Drive

NOISE = {
    "x": 0.02, "y": 0.02, "yaw": 0.001, "vx": 0.02, "vy": 0.02, "yaw_rate": 0.002, "ax": 0.12, "ay": 0.12,
    **{f"wheel_speed_{wheel}": 0.03 for wheel in ("fl", "fr", "rl", "rr")},
}  # fmt: skip
STEP, LOG_EVERY = 0.005, 2
"""s, and steps a logged sample"""
STEER_MAX = 0.2
"""rad"""


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


def simulate(setups: Sequence[Setup], seeds: Sequence[int], *, with_bank: bool = False) -> list[Drive]:
    """Drive every car for its laps; all have as many, and those that leave the road by 15 m end there.

    `with_bank`: the logs have the bank under the car, rad, which no sensor reports.
    """
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
            log.append(_row(z, x, y, f, pedals) | ({"bank": car.road(z.share)[1]} if with_bank else {}))
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
    t: Array = np.arange(stop, dtype=float) * STEP * LOG_EVERY
    return Drive({"t": t} | columns, {}, seed, {})
