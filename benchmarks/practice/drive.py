"""Practice drives: the paper's Eq. 1-3 with per-axle tyres plus undeclared effects, simulated in plain numpy.

Own equations, written without the estimator's model, so that a diagnosis has something independent to be
right about. Many drives run side by side as arrays: 64 drives of 15 minutes take about a minute.

    cd benchmarks && python -m practice OUT.csv --effect rolling_resistance=420 --seed 3
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from hil_gateway.process.arrays import Array

from . import logger, outside
from .car import TYRE, Car, Chassis
from .outside import Motion

NOISE = {
    "x": 0.02, "y": 0.02, "yaw": 0.001, "vx": 0.02, "vy": 0.02, "yaw_rate": 0.003, "ax": 0.15, "ay": 0.15,
}  # fmt: skip
LOG_STEP = 0.01
"""s; the drives are logged at 100 Hz unless asked otherwise."""
HISTORY = 64
"""Steps of past actuation that delays can reach back to."""
LONGEST_S = 1500.0
STEER_RATE, DRIVE_RATE, STEER_MAX, DRIVE_MAX = 0.9, 0.6, 0.26, 0.085
DAHL = 0.004
"""rad over which friction of the steering comes to its full size"""
STATIONS = 2048
LAPS = 8
CAREFUL = (
    "combined_slip", "load_transfer", "load_sensitivity", "grip_", "speed_stall", "turn_asymmetry", "gust", "puncture",
    "brake_oversteer", "temperature_grip", "kerb", "right_push", "short_gusts", "tyre_heat", "slosh", "front_stall",
    "slow_puncture", "pressure_peak", "damaged_floor", "camber_thrust", "kerb_yaw", "wall_gap", "wet_spells",
    "rear_patch", "rear_steer",
)  # fmt: skip
CAREFUL_PACE = 0.87
"""The driver is so much slower in a car that has less grip than the reference speed presumes."""


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


def _oval(rng: np.random.Generator) -> tuple[float, Array, Array, Array, Array]:
    """A flat oval of two straights and two equal left turns, whose curvature comes and goes over 5 % of the lap."""
    length, turning = rng.uniform(2400.0, 4000.0), rng.uniform(0.4, 0.55)
    share = np.arange(STATIONS) / STATIONS
    inside = (np.abs((share % 0.5) - 0.25) < 0.25 * turning).astype(float)
    kernel = np.hanning(STATIONS // 20)
    shape = np.real(np.fft.ifft(np.fft.fft(inside) * np.abs(np.fft.fft(kernel / kernel.sum(), STATIONS))))
    ds = length / STATIONS
    curvature = shape * 2 * np.pi / (shape.sum() * ds)
    heading = np.cumsum(curvature) * ds
    return length, curvature, np.cumsum(np.cos(heading)) * ds, np.cumsum(np.sin(heading)) * ds, heading


def _circle(rng: np.random.Generator) -> tuple[float, Array, Array, Array, Array]:
    """An open circle, turned to the left."""
    length = rng.uniform(300.0, 600.0)
    angle = 2 * np.pi * np.arange(STATIONS) / STATIONS
    radius = length / (2 * np.pi)
    x, y = radius * np.sin(angle), radius * (1 - np.cos(angle))
    return length, np.full(STATIONS, 1 / radius), x, y, angle


COURSES = {"road": _course, "oval": _oval, "circle": _circle}


def _speed_profiles(tracks: _Tracks, laps: int) -> Array:
    """(laps, drives, STATIONS) reference speed: corner limit, then what can be braked and accelerated to.

    From gentle to hard, however many laps there are.
    """
    ds = tracks.length / STATIONS
    profiles = []
    for pace in np.linspace(0.0, 1.0, laps):
        lateral, cap = 4.0 + 8.0 * pace, 38.0 + 22.0 * pace
        v = np.minimum(np.sqrt(lateral / np.maximum(np.abs(tracks.curvature), 1e-4)), cap)
        for _ in range(2):
            for i in range(STATIONS):
                v[:, i] = np.minimum(v[:, i], np.sqrt(v[:, i - 1] ** 2 + 2 * 3.6 * ds))
            for i in range(STATIONS - 1, -1, -1):
                v[:, i] = np.minimum(v[:, i], np.sqrt(v[:, (i + 1) % STATIONS] ** 2 + 2 * 4.6 * ds))
        profiles.append(v)
    return np.array(profiles)


def simulate(
    effects: Sequence[Mapping[str, float]],
    seeds: Sequence[int],
    laps: int = LAPS,
    step: float = 0.005,
    *,
    course: str = "road",
    log_step: float | Sequence[float] = LOG_STEP,
    chassis: Sequence[Chassis] = (),
    noise: Sequence[float] = (),
) -> list[Drive]:
    """Drive every car for `laps` laps of its own course, integrated at `step` s (a divisor of 10 ms and `log_step`).

    `chassis`, `noise`, in units of `NOISE`, and steps of the log may be one a car; without them all are alike.
    """
    generators = [np.random.default_rng(seed) for seed in seeds]
    courses = [COURSES[course](rng) for rng in generators]
    tracks = _Tracks(*(np.array(column) for column in zip(*courses, strict=True)))
    careful = [any(name.startswith(CAREFUL) for name in own) for own in effects]
    reference = _speed_profiles(tracks, laps) * np.where(careful, CAREFUL_PACE, 1.0)[:, None]
    car = Car(effects, seeds, chassis)
    steps = [log_step] * len(seeds) if isinstance(log_step, float) else log_step
    fastest = math.gcd(*(round(one / step) for one in steps)) * step
    raw = _drive(car, tracks, reference, step, log_step=fastest)
    bare = [Drive({}, dict(own), seed) for own, seed in zip(effects, seeds, strict=True)]
    noise = noise or [1.0] * len(seeds)
    return [
        _logged(_every(raw, round(own / fastest)), i, car, drive, laps, log_step=own, noise=noise[i])
        for i, (drive, own) in enumerate(zip(bare, steps, strict=True))
    ]


def _every(raw: Mapping[str, Array], stride: int) -> Mapping[str, Array]:
    """Every so many samples."""
    return {name: values[::stride] for name, values in raw.items()}


@dataclass
class _Fleet:
    """Everything that moves: one entry a car in every array."""

    car: Car
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
        self.temperature = np.full(n, 80.0)
        self.past_steer, self.past_drive = np.zeros((2, HISTORY, n))
        size = self.car.size
        self.lag_steer, self.lag_drive = (
            np.round(size[f"{name}_delay"] / self.step).astype(int) for name in ("steer", "drive")
        )
        self.follow_steer, self.follow_drive = (
            -np.expm1(-self.step / np.maximum(size[f"{name}_delay/lag"], 1e-9)) for name in ("steer", "drive")
        )
        self.hold = STATIONS / np.round(tracks.length / 2.5)
        self.angle, self.torque, self.lagging, self.wheel, self.wheel_rate = np.zeros((5, n))
        self.slack, self.ay, self.slosh, self.heat, self.stuck = np.zeros((5, n))
        self.bent, self.asked, self.brake_heat, self.ax_slow = np.zeros((4, n))

    def act(self) -> None:
        """What the driver does, and what of it reaches wheels and axle."""
        share, offset, mu, _, vx, _, rate, *_ = self.state
        rows, tracks = self.rows, self.tracks
        station = (share % 1.0 * STATIONS // self.hold * self.hold).astype(int) % STATIONS
        ahead = (station + (0.25 * vx / tracks.length * STATIONS).astype(int)) % STATIONS
        lap = np.minimum(share.astype(int), len(self.reference) - 1)
        kappa, target = tracks.curvature[rows, ahead], self.reference[lap, rows, ahead]
        wanted = kappa * (self.car.wheelbase + 0.0012 * vx * vx)
        wanted = wanted - 0.012 * offset - (0.25 + 1.0 / vx) * mu - 0.02 * (rate - kappa * vx)
        wanted = wanted + 0.11 / vx * np.sin(2 * np.pi * 0.9 * self.tick * self.step)
        most = STEER_RATE * self.step
        self.steer = np.clip(self.steer + np.clip(wanted - self.steer, -most, most), -STEER_MAX, STEER_MAX)
        force = (1.2 * (target - vx) + 0.3 * np.sign(target - vx)) * self.car.mass
        pedal = np.clip(force / self.car.tyre["cx"], -0.075, 0.06)
        most = DRIVE_RATE * self.step
        self.drive = np.clip(self.drive + np.clip(pedal - self.drive, -most, most), -DRIVE_MAX, DRIVE_MAX)
        self.past_steer[self.tick % HISTORY], self.past_drive[self.tick % HISTORY] = self.steer, self.drive
        angle = self.past_steer[(self.tick - self.lag_steer) % HISTORY, rows]
        self.lagging += self.follow_steer * (angle - self.lagging)
        angle = self.lagging
        half = 0.5 * self.car.size["steer_play"]
        self.play = np.clip(self.play, angle - half, angle + half)
        self.angle = self._swung(self._rubbed(np.where(half > 0, self.play, angle)))
        asked = self._slackened(self.past_drive[(self.tick - self.lag_drive) % HISTORY, rows])
        self.torque = self.torque + self.follow_drive * (asked - self.torque)
        if self.tick % round(20.0 / self.step) == 0:
            self.flap = np.where(np.sin(0.37 * self.tick * self.step / 20.0 + rows) > 0, 1.0, 0.0)

        at = self.tick * self.step + 40.0 * self.rows
        self.temperature = 80.0 + 14.0 * np.sin(at / 47.0) + 9.0 * np.sin(at / 18.0)
        self.slosh += self.step / outside.SLOSH_S * (self.ay - self.slosh)
        self.ax_slow += self.step / outside.SPRINGS_S * (self.ax - self.ax_slow)
        self.heat += self.step / outside.HEAT_S * (self.ay**2 / 100.0 - self.heat)
        braking = np.clip(-self.torque / 0.05, 0.0, 1.0)
        self.stuck = np.maximum(self.stuck * (1 - self.step / outside.RELEASE_S), braking)
        power = braking * vx / 4.0
        self.brake_heat += self.step / outside.BRAKE_HEAT_S * (power - self.brake_heat)

    def _rubbed(self, angle: Array) -> Array:
        """Angle behind a rack that bends under the friction of its wheels, by Dahl's law."""
        moved, self.asked = angle - self.asked, angle
        limit = np.sign(moved)
        self.bent = limit + (self.bent - limit) * np.exp(-np.abs(moved) / DAHL)
        return np.asarray(angle - 0.5 * self.car.size["steer_play/dahl"] * self.bent)

    def _swung(self, angle: Array) -> Array:
        """Angle of wheels that swing about their steering axis."""
        damping, w, h = self.car.size["steer_resonance"], outside.RESONANCE, self.step
        self.wheel_rate += h * (w * w * (angle - self.wheel) - 2 * damping * w * self.wheel_rate)
        self.wheel = np.where(damping > 0, self.wheel + h * self.wheel_rate, angle)
        self.wheel_rate = np.where(damping > 0, self.wheel_rate, 0.0)
        return self.wheel

    def _slackened(self, drive: Array) -> Array:
        """Drive behind a driveline with play."""
        half = 0.5 * self.car.size["drive_play"]
        self.slack = np.clip(self.slack, drive - half, drive + half)
        return np.where(half > 0, self.slack, drive)

    def rates(self, state: tuple[Array, ...]) -> tuple[Array, ...]:
        """Derivative of the state, then ax and ay."""
        share, offset, mu, yaw, vx, vy, rate, a_f, a_r = state
        sigma = self.car.size["tyre_relaxation"]
        steer = self.car.true_steer(self.angle, vx, rate, self.torque)
        slip = self.car.slips(vx, vy, rate, steer)
        used = (np.where(sigma > 0, a_f, slip[0]), np.where(sigma > 0, a_r, slip[1]))
        motion = Motion(
            self.tick * self.step, share, yaw, vx, vy, rate, steer, self.torque, self.ax, self.flap, self.temperature,
            self.slosh, self.heat, self.stuck, self.brake_heat, self.ax_slow,
        )  # fmt: skip
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
        self.state, self.ax, self.ay = tuple(state), *(0.5 * (first[i] + second[i]) for i in (9, 10))
        self.tick += 1


def _drive(car: Car, tracks: _Tracks, reference: Array, step: float, *, log_step: float) -> dict[str, Array]:
    """Integrate all cars until the slowest has finished; (samples, drives) arrays."""
    fleet, laps = _Fleet(car, tracks, reference, step), len(reference)
    names = ("x", "y", "yaw", "vx", "vy", "yaw_rate", "ax", "ay", "steer", "drive", "lap", "yaw_acc")
    log: dict[str, list[Array]] = {k: [] for k in (*names, *outside.COLUMNS)}
    while np.min(fleet.state[0]) < laps and fleet.tick * step < LONGEST_S:
        fleet.act()
        first = fleet.rates(fleet.state)
        if fleet.tick % round(log_step / step) == 0:
            share, _, _, yaw, vx, vy, rate, *_ = fleet.state
            lap = share.astype(int).astype(float)
            values = (
                fleet.x, fleet.y, yaw, vx, vy, rate, first[9], first[10], fleet.steer, fleet.drive, lap, first[6],
                fleet.flap, fleet.temperature,
            )  # fmt: skip
            for key, value in zip(log, values, strict=True):
                log[key].append(np.array(value))
        fleet.move(first)
    return {key: np.array(values) for key, values in log.items()}


def _logged(
    raw: Mapping[str, Array], i: int, car: Car, drive: Drive, laps: int, *, log_step: float, noise: float
) -> Drive:
    """What the sensors of drive `i` report: mounting errors, then white noise."""
    effects, seed = drive.effects, drive.seed
    rng = np.random.default_rng([seed, 77])
    lap = raw["lap"][:, i]
    stop = int(np.argmax(lap >= laps)) or len(lap)
    names = ("x", "y", "yaw", "vx", "vy", "yaw_rate", "ax", "ay", "steer", "drive")
    columns = {k: raw[k][:stop, i].copy() for k in names}
    ax, ay, rate = columns["ax"].copy(), columns["ay"].copy(), columns["yaw_rate"].copy()
    arm, side, turning = (
        effects.get("imu_lever_arm", 0.0),
        effects.get("imu_lever_arm/y", 0.0),
        raw["yaw_acc"][:stop, i],
    )
    ax, ay = ax - rate**2 * arm - turning * side, ay + turning * arm - rate**2 * side
    angle = effects.get("imu_misalignment", 0.0)
    ax, ay = ax * np.cos(angle) + ay * np.sin(angle), ay * np.cos(angle) - ax * np.sin(angle)
    bias = effects.get("imu_bias", 0.0)
    columns["ax"] = ax * (1 + effects.get("ax_gain", 0.0)) + bias * (car.axis[i] == 0)
    t: Array = np.arange(stop, dtype=float) * log_step
    own = {name: size[i] for name, size in car.size.items()}
    columns["ay"] = outside.sensed(own, ay, columns["vx"], t, car.local.moment[i]) + bias * (car.axis[i] == 1)
    if drift := effects.get("accelerometer_drift", 0.0):
        columns["ax" if car.axis[i] == 0 else "ay"] += _drifting(stop, drift, log_step, seed)
    columns["yaw_rate"] = rate * (1 + effects.get("gyro_gain", 0.0)) + effects.get("imu_bias/yaw_rate", 0.0)
    both = 1 + effects.get("speed_scale/both", 0.0)
    columns["vx"] *= (1 + effects.get("speed_scale", 0.0)) * both
    columns["vy"] *= both
    columns = logger.recorded(effects, columns, t, car.local.moment[i])
    t = columns.pop("t")
    disturbed = {name: outside.disturbed(effects, name, raw["vx"][:stop, i], seed) for name in NOISE}
    for name, std in NOISE.items():
        louder, spikes = disturbed[name]
        columns[name] = columns[name] + spikes + noise * std * louder * rng.normal(size=stop)
    decimals = {"yaw": 5, "yaw_rate": 5, "steer": 5, "drive": 5}
    logged: dict[str, Array] = {"t": t} | {k: np.round(v, decimals.get(k, 3)) for k, v in columns.items()}
    logged["lap"] = lap[:stop]
    if outside.CAUSED_BY_COLUMN & set(effects):
        logged |= {name: np.round(raw[name][:stop, i], 2) for name in outside.COLUMNS}
    return Drive(logged, effects, seed)


def _drifting(count: int, std: float, step: float, seed: int) -> Array:
    """Noise (count,) of a first-order Markov process."""
    rng, keep = np.random.default_rng([seed, 78]), float(np.exp(-step / outside.DRIFT_S))
    out = std * rng.normal(size=count)
    for k in range(1, count):
        out[k] = keep * out[k - 1] + np.sqrt(1 - keep**2) * out[k]
    return out
