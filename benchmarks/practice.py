"""Practice drives: the paper's Eq. 1-3 with per-axle tyres plus undeclared effects, simulated in plain numpy.

Own equations, written without the estimator's model, so that a diagnosis has something independent to be
right about. Many drives run side by side as arrays: 64 drives of 15 minutes take about a minute.

    python benchmarks/practice.py OUT.csv --effect rolling_resistance=420 --seed 3
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

GRAVITY = 9.80665
MASS, INERTIA, LF, LR = 787.3, 1000.0, 1.724, 1.248
WHEELBASE = LF + LR
TYRE = {"cx": 62000.0, "bf": 11.5, "cf": 1.55, "df": 1.6033, "br": 13.0, "cr": 1.6, "dr": 1.5847}
NOISE = {
    "x": 0.02, "y": 0.02, "yaw": 0.001, "vx": 0.02, "vy": 0.02, "yaw_rate": 0.003, "ax": 0.15, "ay": 0.15,
}  # fmt: skip
LOG_STEP = 0.01
"""s; the drives are logged at 100 Hz."""
HISTORY = 64
"""Steps of past actuation that delays can reach back to."""
LONGEST_S = 1500.0
STEER_RATE, DRIVE_RATE, STEER_MAX, DRIVE_MAX = 0.9, 0.6, 0.26, 0.085
STATIONS = 2048
LAPS = 8

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
    # outside the catalogue
    "steer_compliance": (0.08, 0.2, False),
    "grip_patch": (0.15, 0.4, False),
    "grip_step": (0.08, 0.2, False),
    "gust": (500.0, 1500.0, True),
    "throttle_yaw": (300.0, 900.0, True),
    "steer_play": (0.004, 0.01, False),
    "speed_stall": (0.1, 0.25, False),
    "channel_force": (300.0, 800.0, True),
}
OUTSIDE = {
    "steer_compliance": ({"ay", "yaw_acc", "vy_dot"}, {"vx", "speed", "steer", "slip_f"}),
    "grip_patch": ({"ay", "vy_dot", "yaw_acc"}, {"track_position"}),
    "grip_step": ({"ay", "vy_dot", "yaw_acc"}, {"t"}),
    "gust": ({"ay", "vy_dot", "yaw_acc"}, {"track_position"}),
    "throttle_yaw": ({"yaw_acc"}, {"drive", "throttle"}),
    "steer_play": ({"ay", "yaw_acc", "vy_dot"}, {"steer_rate", "steer"}),
    "speed_stall": ({"ay", "yaw_acc", "vy_dot"}, {"vx", "speed"}),
    "channel_force": ({"ax", "vx_dot"}, {"flap"}),
}
"""effect outside the catalogue -> channels and signals either of which is a right answer"""


@dataclass(frozen=True)
class Drive:
    """One drive: logged columns, (n,) each, and what is true."""

    columns: dict[str, Array]
    effects: dict[str, float]
    seed: int
    tyre: dict[str, float] = field(default_factory=lambda: dict(TYRE))

    def write(self, path: Path) -> None:
        """Write the drive log as CSV."""
        names = list(self.columns)
        table = np.column_stack([self.columns[n] for n in names])
        np.savetxt(path, table, fmt="%.6g", delimiter=",", header=",".join(names), comments="")


def draw_size(name: str, rng: np.random.Generator) -> float:
    """A size of effect `name` that a race engineer would call sensible."""
    low, high, signed = SIZES[name]
    size = float(rng.uniform(low, high))
    return -size if signed and rng.random() < 0.5 else size


@dataclass(frozen=True)
class _Tracks:
    """Courses of several drives on equal stations: arrays (drives, STATIONS)."""

    length: Array
    curvature: Array
    x: Array
    y: Array
    heading: Array


def _course(rng: np.random.Generator) -> tuple[float, Array, Array, Array, Array]:
    """A closed course: a circle whose radius is modulated by a few harmonics, none tighter than 12 m."""
    while True:
        angle = np.linspace(0.0, 2 * np.pi, 8 * STATIONS, endpoint=False)
        radius = np.ones_like(angle)
        for k in range(2, 8):
            radius += rng.normal() * 0.42 / k * np.cos(k * angle + rng.uniform(0, 2 * np.pi))
        x, y = radius * np.cos(angle), radius * np.sin(angle)
        arc = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
        scale = rng.uniform(2900.0, 3900.0) / arc[-1]
        at = np.linspace(0.0, arc[-1], STATIONS, endpoint=False)
        x, y = scale * np.interp(at, arc, x), scale * np.interp(at, arc, y)
        length = scale * arc[-1]
        ds = length / STATIONS
        dx, dy = (np.gradient(np.concatenate([a[-3:], a, a[:3]]), ds) for a in (x, y))
        heading = np.unwrap(np.arctan2(dy, dx))
        curvature = np.gradient(heading, ds)[3:-3]
        kernel = np.hanning(25)
        wrapped = np.concatenate([curvature[-24:], curvature, curvature[:24]])
        curvature = np.convolve(wrapped, kernel / kernel.sum(), "same")[24:-24]
        if radius.min() > 0.3 and 1 / 60 < np.abs(curvature).max() < 1 / 12:
            return length, curvature, x, y, heading[3:-3]


def _speed_profiles(tracks: _Tracks, rng: Sequence[np.random.Generator]) -> Array:
    """(laps, drives, STATIONS) reference speed: corner limit, then what can be braked and accelerated to."""
    ds = tracks.length / STATIONS
    profiles = []
    for lap in range(LAPS):
        lateral, cap = 4.0 + 8.0 * lap / (LAPS - 1), 38.0 + 22.0 * lap / (LAPS - 1)
        v = np.minimum(np.sqrt(lateral / np.maximum(np.abs(tracks.curvature), 1e-4)), cap)
        for _ in range(2):
            for i in range(STATIONS):
                v[:, i] = np.minimum(v[:, i], np.sqrt(v[:, i - 1] ** 2 + 2 * 3.6 * ds))
            for i in range(STATIONS - 1, -1, -1):
                v[:, i] = np.minimum(v[:, i], np.sqrt(v[:, (i + 1) % STATIONS] ** 2 + 2 * 4.6 * ds))
        profiles.append(v)
    return np.array(profiles)


@dataclass(frozen=True)
class _Motion:
    """Where and how every car moves at one instant."""

    t: float
    share: Array
    yaw: Array
    vx: Array
    vy: Array
    rate: Array
    steer: Array
    drive: Array
    ax_before: Array
    flap: Array


class _Car:
    """Forces of many cars at once; every effect is a column of sizes, zero (or one) where it is off."""

    def __init__(self, effects: Sequence[Mapping[str, float]], tracks: _Tracks, seeds: Sequence[int]) -> None:
        self.size = {name: np.array([e.get(name, 0.0) for e in effects]) for name in SIZES}
        rng = np.random.default_rng(seeds)
        n = len(effects)
        self.phase = rng.uniform(0, 2 * np.pi, (4, n))
        self.wind_from = rng.uniform(0, 2 * np.pi, n)
        self.stretch = rng.uniform(0.1, 0.6, n)
        self.step_at = rng.uniform(0.3, 0.5, n)
        self.axis = rng.integers(0, 2, n)
        self.tracks = tracks
        self.front, self.rear = MASS * GRAVITY * LR / WHEELBASE, MASS * GRAVITY * LF / WHEELBASE
        self.fmax = np.where(self.size["drive_saturation"] > 0, self.size["drive_saturation"], 1e9)

    def grade(self, lap_share: Array) -> tuple[Array, Array]:
        """Grade and bank, rad, at a share of the lap."""
        wave = 2 * np.pi * lap_share
        p = self.phase
        grade = 0.7 * np.sin(2 * wave + p[0]) + 0.3 * np.sin(5 * wave + p[1])
        bank = 0.6 * np.sin(3 * wave + p[2]) + 0.4 * np.sin(4 * wave + p[3])
        return self.size["road_grade"] * grade, self.size["road_bank"] * bank

    def slips(self, vx: Array, vy: Array, rate: Array, steer: Array) -> tuple[Array, Array]:
        """Slip angles, Eq. (3)."""
        return steer - np.arctan2(vy + LF * rate, vx), -np.arctan2(vy - LR * rate, vx)

    def accelerations(self, at: _Motion, slip: tuple[Array, Array]) -> tuple[Array, ...]:
        """Specific forces, yaw acceleration, d/dt vx and d/dt vy of every car."""
        t, share, yaw, vx, vy, rate, steer, drive, ax_before, flap = (
            at.t, at.share, at.yaw, at.vx, at.vy, at.rate, at.steer, at.drive, at.ax_before, at.flap,
        )  # fmt: skip
        s = self.size
        cx = TYRE["cx"]
        braking = np.minimum(drive, 0.0) * cx
        front_x = s["front_brake"] * braking
        rear_x = cx * drive - front_x - s["engine_braking"] * (drive <= 0)
        rear_x = self.fmax * np.tanh(rear_x / self.fmax)
        wx, wy = s["wind"] * np.cos(self.wind_from - yaw), s["wind"] * np.sin(self.wind_from - yaw)
        body_x = -s["aero_drag"] * vx * vx - s["rolling_resistance"]
        body_x = body_x - 0.516 * ((vx - wx) * np.abs(vx - wx) - vx * vx) + s["channel_force"] * flap
        body_y = 0.7 * wy * vx
        in_stretch = ((share - self.stretch) % 1.0) < 0.07
        body_y = body_y + s["gust"] * in_stretch
        transfer = s["load_transfer"] * MASS * ax_before / WHEELBASE
        down = s["aero_downforce"] * vx * vx
        fz_f, fz_r = self.front + 0.4 * down - transfer, self.rear + 0.6 * down + transfer
        grip = 1 + s["grip_drift"] * t - s["grip_patch"] * in_stretch - s["grip_step"] * (t > self.step_at * 900.0)
        grip = grip - s["speed_stall"] / (1 + np.exp(-np.clip((vx - 40.0) / 1.5, -50, 50)))
        d_f = TYRE["df"] * (1 - s["load_sensitivity"] * (fz_f / self.front - 1)) * grip
        d_r = TYRE["dr"] * (1 - s["load_sensitivity"] * (fz_r / self.rear - 1)) * grip
        d_f = d_f * (1 + s["turn_asymmetry"] * np.sign(slip[0]))
        d_r = d_r * (1 + s["turn_asymmetry"] * np.sign(slip[1]))
        fy_f = d_f * fz_f * np.sin(TYRE["cf"] * np.arctan(TYRE["bf"] * slip[0]))
        fy_r = d_r * fz_r * np.sin(TYRE["cr"] * np.arctan(TYRE["br"] * slip[1]))
        k = s["combined_slip"]
        fy_f = fy_f * np.sqrt(np.maximum(1 - (k * front_x / (d_f * fz_f)) ** 2, 0.05))
        fy_r = fy_r * np.sqrt(np.maximum(1 - (k * rear_x / (d_r * fz_r)) ** 2, 0.05))
        sin, cos = np.sin(steer), np.cos(steer)
        moment = -s["yaw_damping"] * rate + s["throttle_yaw"] * np.maximum(drive, 0) / 0.05
        ax = (rear_x + front_x * cos - fy_f * sin + body_x) / MASS
        ay = (fy_r + fy_f * cos + front_x * sin + body_y) / MASS
        yaw_acc = ((fy_f * cos + front_x * sin) * LF - fy_r * LR + moment) / INERTIA
        grade, bank = self.grade(share)
        vx_dot = ax + vy * rate - GRAVITY * np.sin(grade)
        vy_dot = ay - vx * rate - GRAVITY * np.sin(bank)
        return ax, ay, yaw_acc, vx_dot, vy_dot

    def true_steer(self, reported: Array, vx: Array) -> Array:
        """Road-wheel angle behind the reported one (delay and play are applied by the caller)."""
        s = self.size
        steer = reported * (1 + s["steer_scale"]) + s["steer_offset"]
        return steer * (1 - s["steer_compliance"] * (vx / 40.0) ** 2)


def simulate(
    effects: Sequence[Mapping[str, float]], seeds: Sequence[int], laps: int = LAPS, step: float = 0.005
) -> list[Drive]:
    """Drive every car for `laps` laps of its own course, integrated at `step` s (a divisor of 10 ms)."""
    generators = [np.random.default_rng(seed) for seed in seeds]
    courses = [_course(rng) for rng in generators]
    tracks = _Tracks(*(np.array(column) for column in zip(*courses, strict=True)))
    reference = _speed_profiles(tracks, generators)
    car = _Car(effects, tracks, seeds)
    raw = _drive(car, tracks, reference, laps, step)
    return [_logged(raw, i, car, Drive({}, dict(effects[i]), seeds[i]), laps) for i in range(len(effects))]


@dataclass
class _Fleet:
    """Everything that moves: one entry a car in every array."""

    car: _Car
    tracks: _Tracks
    reference: Array
    step: float

    def __post_init__(self) -> None:
        n, tracks = len(self.tracks.length), self.tracks
        self.rows, self.tick = np.arange(n), 0
        first = np.minimum(self.reference[0][:, 0], 15.0)
        self.x, self.y = tracks.x[:, 0].copy(), tracks.y[:, 0].copy()
        # share of the lap, offset, heading error, yaw, vx, vy, yaw rate, relaxed slips
        self.state = (*np.zeros((3, n)), tracks.heading[:, 0].copy(), first, *np.zeros((4, n)))
        self.steer, self.drive, self.play, self.flap, self.ax = np.zeros((5, n))
        self.past_steer, self.past_drive = np.zeros((2, HISTORY, n))
        self.lag_steer, self.lag_drive = (
            np.round(self.car.size[f"{name}_delay"] / self.step).astype(int) for name in ("steer", "drive")
        )
        self.hold = STATIONS / np.round(tracks.length / 2.5)
        self.angle, self.torque = np.zeros((2, n))

    def act(self) -> None:
        """What the driver does, and what of it reaches wheels and axle."""
        share, offset, mu, _, vx, _, rate, *_ = self.state
        rows, tracks = self.rows, self.tracks
        station = (share % 1.0 * STATIONS // self.hold * self.hold).astype(int) % STATIONS
        ahead = (station + (0.25 * vx / tracks.length * STATIONS).astype(int)) % STATIONS
        lap = np.minimum(share.astype(int), LAPS - 1)
        kappa, target = tracks.curvature[rows, ahead], self.reference[lap, rows, ahead]
        wanted = kappa * (WHEELBASE + 0.0012 * vx * vx)
        wanted = wanted - 0.012 * offset - (0.25 + 1.0 / vx) * mu - 0.02 * (rate - kappa * vx)
        wanted = wanted + 0.11 / vx * np.sin(2 * np.pi * 0.9 * self.tick * self.step)
        most = STEER_RATE * self.step
        self.steer = np.clip(self.steer + np.clip(wanted - self.steer, -most, most), -STEER_MAX, STEER_MAX)
        pedal = np.clip((1.2 * (target - vx) + 0.3 * np.sign(target - vx)) * MASS / TYRE["cx"], -0.075, 0.06)
        most = DRIVE_RATE * self.step
        self.drive = np.clip(self.drive + np.clip(pedal - self.drive, -most, most), -DRIVE_MAX, DRIVE_MAX)
        self.past_steer[self.tick % HISTORY], self.past_drive[self.tick % HISTORY] = self.steer, self.drive
        angle = self.past_steer[(self.tick - self.lag_steer) % HISTORY, rows]
        half = 0.5 * self.car.size["steer_play"]
        self.play = np.clip(self.play, angle - half, angle + half)
        self.angle = np.where(half > 0, self.play, angle)
        self.torque = self.past_drive[(self.tick - self.lag_drive) % HISTORY, rows]
        if self.tick % round(20.0 / self.step) == 0:
            self.flap = np.where(np.sin(0.37 * self.tick * self.step / 20.0 + rows) > 0, 1.0, 0.0)

    def rates(self, state: tuple[Array, ...]) -> tuple[Array, ...]:
        """Derivative of the state, then ax and ay."""
        share, offset, mu, yaw, vx, vy, rate, a_f, a_r = state
        sigma = self.car.size["tyre_relaxation"]
        steer = self.car.true_steer(self.angle, vx)
        slip = self.car.slips(vx, vy, rate, steer)
        used = (np.where(sigma > 0, a_f, slip[0]), np.where(sigma > 0, a_r, slip[1]))
        motion = _Motion(self.tick * self.step, share, yaw, vx, vy, rate, steer, self.torque, self.ax, self.flap)
        ax, ay, yaw_acc, vx_dot, vy_dot = self.car.accelerations(motion, used)
        kappa = self.tracks.curvature[self.rows, (share % 1.0 * STATIONS).astype(int) % STATIONS]
        along = (vx * np.cos(mu) - vy * np.sin(mu)) / (1 - kappa * offset)
        sideways = vx * np.sin(mu) + vy * np.cos(mu)
        build_up = vx / np.where(sigma > 0, sigma, 1.0)
        return (
            along / self.tracks.length, sideways, rate - kappa * along, rate, vx_dot, vy_dot, yaw_acc,
            build_up * (slip[0] - a_f), build_up * (slip[1] - a_r), ax, ay,
        )  # fmt: skip

    def move(self, first: tuple[Array, ...]) -> None:
        """One step of Heun's method from the derivative `first` at its start."""
        h = self.step
        second = self.rates(tuple(a + h * b for a, b in zip(self.state, first, strict=False)))
        _, _, _, yaw, vx, vy, rate, *_ = self.state
        course = yaw + 0.5 * h * rate
        self.x = self.x + h * (vx * np.cos(course) - vy * np.sin(course))
        self.y = self.y + h * (vx * np.sin(course) + vy * np.cos(course))
        state = [a + 0.5 * h * (b + c) for a, b, c in zip(self.state, first, second, strict=False)]
        state[4] = np.maximum(state[4], 3.0)
        self.state, self.ax = tuple(state), 0.5 * (first[9] + second[9])
        self.tick += 1


def _drive(car: _Car, tracks: _Tracks, reference: Array, laps: int, step: float) -> dict[str, Array]:
    """Integrate all cars until the slowest has finished; (samples, drives) arrays."""
    fleet = _Fleet(car, tracks, reference, step)
    log: dict[str, list[Array]] = {
        k: [] for k in ("x", "y", "yaw", "vx", "vy", "yaw_rate", "ax", "ay", "steer", "drive", "lap", "yaw_acc", "flap")
    }
    while np.min(fleet.state[0]) < laps and fleet.tick * step < LONGEST_S:
        fleet.act()
        first = fleet.rates(fleet.state)
        if fleet.tick % round(LOG_STEP / step) == 0:
            share, _, _, yaw, vx, vy, rate, *_ = fleet.state
            lap = share.astype(int).astype(float)
            values = (
                fleet.x, fleet.y, yaw, vx, vy, rate, first[9], first[10], fleet.steer, fleet.drive, lap, first[6],
                fleet.flap,
            )  # fmt: skip
            for key, value in zip(log, values, strict=True):
                log[key].append(np.array(value))
        fleet.move(first)
    return {key: np.array(values) for key, values in log.items()}


def _logged(raw: Mapping[str, Array], i: int, car: _Car, drive: Drive, laps: int) -> Drive:
    """What the sensors of drive `i` report: mounting errors, then white noise."""
    effects, seed = drive.effects, drive.seed
    rng = np.random.default_rng([seed, 77])
    lap = raw["lap"][:, i]
    stop = int(np.argmax(lap >= laps)) or len(lap)
    names = ("x", "y", "yaw", "vx", "vy", "yaw_rate", "ax", "ay", "steer", "drive")
    columns = {k: raw[k][:stop, i].copy() for k in names}
    ax, ay, rate = columns["ax"].copy(), columns["ay"].copy(), columns["yaw_rate"].copy()
    arm = effects.get("imu_lever_arm", 0.0)
    ax, ay = ax - rate**2 * arm, ay + raw["yaw_acc"][:stop, i] * arm
    angle = effects.get("imu_misalignment", 0.0)
    ax, ay = ax * np.cos(angle) + ay * np.sin(angle), ay * np.cos(angle) - ax * np.sin(angle)
    bias = effects.get("imu_bias", 0.0)
    columns["ax"] = ax + bias * (car.axis[i] == 0)
    columns["ay"] = ay + bias * (car.axis[i] == 1)
    columns["vx"] = columns["vx"] * (1 + effects.get("speed_scale", 0.0))
    for name, std in NOISE.items():
        columns[name] = columns[name] + std * rng.normal(size=stop)
    decimals = {"yaw": 5, "yaw_rate": 5, "steer": 5, "drive": 5}
    logged = {"t": np.arange(stop) * LOG_STEP} | {k: np.round(v, decimals.get(k, 3)) for k, v in columns.items()}
    logged["lap"] = lap[:stop]
    if "channel_force" in effects:
        logged["flap"] = raw["flap"][:stop, i]
    return Drive(logged, effects, seed)


def main() -> None:
    """Write one drive as CSV."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--effect", action="append", default=[], metavar="NAME=SIZE")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    effects = {name: float(size) for name, size in (item.split("=") for item in arguments.effect)}
    simulate([effects], [arguments.seed])[0].write(arguments.out)


if __name__ == "__main__":
    main()
