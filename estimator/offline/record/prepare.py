"""From a drive log to what a fit needs: smoothed states, channels with their noise, weights."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from estimator.drive_log.derived import brake_share
from estimator.drive_log.smoothing import Smoothed, smooth_velocity, wiener
from estimator.drive_log.table import DriveLog
from estimator.model.columns import CHANNELS
from estimator.model.single_track import AUXILIARY, SIGNALS
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.process.arrays import Array

MOVING_SHARE = 0.25
"""Samples slower than this share of the log's fast speed (95th percentile) carry no tyre information."""

EDGE_S = 0.5
"""Left out at either end of a segment, where smoothing has one side only."""

SPIN = 0.5
"""Side-slip of the body, rad, beyond which a car spins or slides sideways: Eq. 3 no longer describes it."""

MIN_SEGMENT_S = 3.0
"""Shorter segments are left out: nothing can be smoothed in them."""


@dataclass(frozen=True)
class Samples:
    """Samples for a fit: n rows, SI.

    Attributes:
        inputs: (n_inputs, n) smoothed `SIGNALS`, then `AUXILIARY` signals (neutral 0 where the log has none).
        channels: (5, n) measured `CHANNELS`.
        noise: (5,) standard deviation of the noise in each channel, the floor no model can pass.
        state_error: standard deviation left in vx, vy, yaw_rate after smoothing.
        t: (n,) s.
        segment: (n,) uninterrupted stretch.
        row: (n,) row of the log each sample comes from (the middle one of a block).
        step: s between neighbouring samples.
        available: auxiliary signals the log really has.
    """

    inputs: Array
    channels: Array
    noise: Array
    state_error: Array
    t: Array
    segment: NDArray[np.int64]
    row: NDArray[np.int64]
    step: float
    available: frozenset[str]

    def __len__(self) -> int:
        return int(self.t.size)

    def __getitem__(self, name: str) -> Array:
        """A signal, auxiliary or channel by name; a name in both means the signal."""
        names = (*SIGNALS, *AUXILIARY)
        return np.asarray(self.inputs[names.index(name)] if name in names else self.channels[CHANNELS.index(name)])

    def select(self, rows: NDArray[np.bool_]) -> Samples:
        """The samples where `rows` (n,) is true."""
        return replace(
            self, inputs=self.inputs[:, rows], channels=self.channels[:, rows], t=self.t[rows],
            segment=self.segment[rows], row=self.row[rows],
        )  # fmt: skip

    def select_range(self, start: int, stop: int) -> Samples:
        """Samples `start` to `stop`, without copying."""
        rows = slice(start, stop)
        return replace(
            self, inputs=self.inputs[:, rows], channels=self.channels[:, rows], t=self.t[rows],
            segment=self.segment[rows], row=self.row[rows],
        )  # fmt: skip

    def thin(self, factor: int) -> Samples:
        """Averages over blocks of `factor` neighbouring samples: the same information in a fraction of the rows.

        White noise falls by sqrt(factor); blocks never reach across gaps.
        """
        if factor <= 1:
            return self
        starts = _block_starts(self, factor)
        rows = (starts[:, None] + np.arange(factor)).ravel()

        def mean(a: Array) -> Array:
            return np.asarray(a[..., rows].reshape(*a.shape[:-1], -1, factor).mean(-1))

        middle = starts + factor // 2
        return replace(
            self, inputs=mean(self.inputs), channels=mean(self.channels), t=mean(self.t), segment=self.segment[middle],
            row=self.row[middle], step=self.step * factor, noise=self.noise * self._thinned_noise(factor),
        )  # fmt: skip

    def _thinned_noise(self, factor: int) -> Array:
        """Only the accelerometers' noise is white; that of derivatives is in band and stays."""
        return np.array([factor**-0.5 if c in ("ax", "ay") else 1.0 for c in CHANNELS])


def _block_starts(samples: Samples, factor: int) -> NDArray[np.int64]:
    consecutive = np.diff(samples.row, prepend=samples.row[0] - 10**9) <= _row_step(samples)
    consecutive &= np.diff(samples.segment, prepend=-1) == 0
    stretch_starts = np.flatnonzero(~consecutive)
    stretch_stops = np.append(stretch_starts[1:], len(samples))
    return np.concatenate(
        [np.arange(a, b - factor + 1, factor) for a, b in zip(stretch_starts, stretch_stops, strict=True)]
    ).astype(np.int64)


def _row_step(samples: Samples) -> int:
    return int(np.median(np.diff(samples.row)))


def prepare(log: DriveLog, auxiliary: Mapping[str, Array] | None = None, smooth: bool = True) -> Samples:
    """Smooth the states of `log`, differentiate, and leave out rows at standstill, in spins and at ends of segments.

    Args:
        log: the data set.
        auxiliary: further auxiliary signals by name, (len(log),) each; they replace those of the log.
        smooth: False takes the states as measured (the plain fit, biased by noise in the slip angles).
    """
    names = (*SIGNALS, *AUXILIARY)
    inputs = np.zeros((len(names), len(log)))
    channels = np.zeros((len(CHANNELS), len(log)))
    given = {**_auxiliary_of(log), **(auxiliary or {})}
    for name in AUXILIARY:
        if name in given:
            inputs[names.index(name)] = given[name]
    pieces: list[tuple[int, Array, Array]] = []
    keep = np.zeros(len(log), bool)
    for rows in log.segments():
        if rows.stop - rows.start < MIN_SEGMENT_S / log.step:
            continue
        states, channels[:, rows], noise, error = _segment(log, rows, smooth)
        inputs[: len(SIGNALS), rows] = states
        edge = round(EDGE_S / log.step)
        keep[rows.start + edge : rows.stop - edge] = True
        pieces.append((rows.stop - rows.start, noise, error))
    keep &= (log["vx"] > moving_speed(log)) & ~spinning(log)
    rates = _rates(log, inputs)
    for name, rate in rates.items():
        if name not in given:
            inputs[names.index(name)] = rate
    noise, error = _pooled(pieces)
    everything = Samples(
        inputs, channels, noise, error, log["t"], log.segment, np.arange(len(log)), log.step,
        frozenset(given) | frozenset(rates),
    )  # fmt: skip
    return everything.select(keep)


def moving_speed(log: DriveLog) -> float:
    """Speed gate, m/s, in proportion to the car's own speeds so that a model car passes it too."""
    return MOVING_SHARE * fast_speed(log)


def fast_speed(log: DriveLog) -> float:
    """Speed, m/s, that the car exceeds in a twentieth of the log."""
    return float(np.quantile(log["vx"], 0.95))


def spinning(log: DriveLog) -> NDArray[np.bool_]:
    """(n,) rows within `EDGE_S` of a spin: smoothing carries its jerk that far."""
    fast = np.hypot(log["vx"], log["vy"]) > moving_speed(log)
    spin = fast & (np.abs(log["vy"]) > np.tan(SPIN) * log["vx"])
    return np.asarray(np.convolve(spin, np.ones(2 * round(EDGE_S / log.step) + 1), "same") > 0.5)


def _auxiliary_of(log: DriveLog) -> dict[str, Array]:
    names = ("yaw", "throttle", "brake", "brake_balance", "gear", "engine_speed", "ax", "t", "known_bank")
    return {name: brake_share(log[name]) if name == "brake" else log[name] for name in names if name in log}


def _rates(log: DriveLog, inputs: Array) -> dict[str, Array]:
    rates = {}
    for name in ("steer", "drive"):
        rates[f"{name}_rate"] = np.gradient(inputs[SIGNALS.index(name)], log.step)
    return rates


def _segment(log: DriveLog, rows: slice, smooth: bool) -> tuple[Array, Array, Array, Array]:
    """Smoothed states (5, m), channels (5, m), noise (5,) and state error (3,) of one segment."""
    step = log.step
    vx, vy, yaw_rate, ax, ay = (log[n][rows] for n in ("vx", "vy", "yaw_rate", "ax", "ay"))
    omega = wiener(yaw_rate, step)
    forward = smoothed_velocity(log, "ax", vx, ax + vy * omega.value, step)
    sideways = smoothed_velocity(log, "ay", vy, ay - forward.value * omega.value, step)
    states = np.stack([forward.value, sideways.value, omega.value]) if smooth else np.stack([vx, vy, yaw_rate])
    states = np.vstack([states, log["steer"][rows], log["drive"][rows]])
    channels = np.stack([ax, ay, omega.rate, forward.rate, sideways.rate])
    noise = np.array(
        [
            _noise_of(log, "ax", ax, forward, step), _noise_of(log, "ay", ay, sideways, step),
            omega.rate_error, forward.rate_error, sideways.rate_error,
        ]
    )  # fmt: skip
    return states, channels, noise, np.array([forward.value_error, sideways.value_error, omega.value_error])


def smoothed_velocity(log: DriveLog, accelerometer: str, velocity: Array, acceleration: Array, step: float) -> Smoothed:
    """A derived acceleration says nothing the velocity does not."""
    return wiener(velocity, step) if accelerometer in log.derived else smooth_velocity(velocity, acceleration, step)


def _noise_of(log: DriveLog, name: str, values: Array, velocity: Smoothed, step: float) -> float:
    return velocity.rate_error if name in log.derived else wiener(values, step).noise


def _pooled(pieces: list[tuple[int, Array, Array]]) -> tuple[Array, Array]:
    from hil_gateway.process.errors import InputError

    if not pieces:
        raise InputError(f"the log has no uninterrupted stretch of {MIN_SEGMENT_S:g} s: nothing can be identified")
    weight = np.array([n for n, _, _ in pieces], float)
    weight /= weight.sum()
    noise = np.sqrt(weight @ np.stack([n**2 for _, n, _ in pieces]))
    error = np.sqrt(weight @ np.stack([e**2 for _, _, e in pieces]))
    return noise, error


def slip_angles(samples: Samples, vehicle: Vehicle) -> tuple[Array, Array]:
    """(front, rear) slip angles, Eq. (3), rad."""
    vx, vy, yaw_rate, steer = (samples[n] for n in ("vx", "vy", "yaw_rate", "steer"))
    front = steer - np.arctan2(vy + vehicle.lf * yaw_rate, vx)
    return front, -np.arctan2(vy - vehicle.lr * yaw_rate, vx)
