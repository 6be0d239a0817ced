"""A drive log cut into windows: smoothed states, measured channels with white noise, laps.

Every fit works on block means inside windows, 40 ms and 2 s for an AV-24. What is compared with a model are the five
measured signals themselves, whose noise is white: differentiating a sensor would make it blue. Smoothing acts
only on the states a prediction is linearised at, so that no filter can shift a channel in time and pass for an
effect.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.drive_log.derived import OF_PEDALS, brake_share
from estimator.drive_log.smoothing import Smoothed, wiener
from estimator.drive_log.table import DriveLog
from estimator.model.basis import Basis, make_basis
from estimator.model.extra_load import extra_loads
from estimator.model.memory import axle_courses
from estimator.model.parameters import table_car
from estimator.model.single_track import AUXILIARY, SIGNALS
from estimator.offline.record.laps import lap_numbers, scored_laps, track_position
from estimator.offline.record.past import Past
from estimator.offline.record.prepare import smoothed_velocity
from estimator.offline.record.reported_inputs import without_noise
from estimator.offline.record.window_columns import WindowBasis
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.process.arrays import Array, Ints
from hil_gateway.process.errors import InputError

BLOCK = 0.0727
"""Length of a block over the car's own time: 25 Hz for an AV-24, above anything its body does."""
WINDOW = 3.633
"""The same of a window, 2 s for an AV-24: long enough for slow effects to add up, short enough that the integrated
yaw-rate noise stays below the sensor's."""
KERNEL = 0.454
"""The same of `Record.kernel_s`, 0.25 s for an AV-24."""
WINDOWS_MIN = 20
"""Fewer cannot be learnt from, chosen by and scored on."""
SLOWEST = 0.15
"""Windows slower than this share of the log's fast speed (95th percentile) carry no tyre information."""
SPUN = 0.7
"""Lateral over forward velocity beyond which a car has spun: Eq. (1-3) describe driving (35 deg)."""
GROWS_S = 0.5
"""Side slip that is larger than so long before is growing; a driver corrects within that time."""
EDGE_S = 0.3
STRAIGHT_BELOW = 1.0
"""Lateral acceleration, m/s2, below which the car does not turn in either direction."""
STATES = ("vx", "vy", "yaw_rate")
MEASURED = ("ax", "ay", "yaw_rate", "vx", "vy")
"""Measured counterpart of each predicted channel of `single_track.CHANNELS`: itself, or its integral."""
STATE_ROWS = [MEASURED.index(name) for name in STATES]
"""Rows of `MEASURED` that are states, and of the channels that are their derivatives."""
LATERAL_ROWS = [MEASURED.index(name) for name in ("ay", "yaw_rate", "vy")]


@dataclass(frozen=True)
class RoadProfile:
    """A bank or grade (rad) as the prior of its effect: (n,) coefficients over the lap, (n, n) precision.

    `confidence` is the probability, by laps left out in turn, that it predicts one more lap better than a level road.
    """

    coefficients: Array
    precision: Array
    confidence: float = 1.0


@dataclass(frozen=True)
class Record:
    """One data set ready to be explained.

    Attributes:
        signals: (n,) arrays at the log's rate: smoothed states, inputs, auxiliaries, extra columns.
        measured: (5, n) as measured, in the order of `MEASURED`.
        noise: (5,) standard deviation of the white noise of each measured channel.
        used: (5,) which of them are sensors of their own and can be trusted; the others are shown, not fitted.
        state_error: (3,) standard deviation left in the smoothed vx, vy, yaw rate.
        rows: (windows, blocks, q) rows of each block of each window.
        lap: (windows,) number of the lap, or of any other group that is held out together, consecutive from 0.
        lap_of_row: (n,) number of the lap by the log, or of a stretch of time where it has no laps.
        lap_length: m; 0 where there is no track position.
        vy_displaced: whether what the repair of a vy that is used has left is estimated along with the tyres.
        pedals: whether the drive was derived from throttle and brake, whose zero and scales nobody measured.
        road: what kinematics say of `road_bank` and `road_grade`; empty where there is none or it is not known.
    """

    signals: Mapping[str, Array]
    measured: Array
    noise: Array
    used: NDArray[np.bool_]
    state_error: Array
    rows: Ints
    lap: Ints
    lap_of_row: Ints
    step: float
    lap_length: float
    has_laps: bool
    vehicle: Vehicle
    extra: tuple[str, ...] = ()
    bases: Mapping[str, Basis] = field(default_factory=dict)
    road: Mapping[str, RoadProfile] = field(default_factory=dict)
    pedals: bool = False
    vy_displaced: bool = False

    def __reduce__(self) -> tuple[type[Record], tuple[Any, ...]]:
        """Another process computes anew what is derived from the fields."""
        return Record, tuple(getattr(self, entry.name) for entry in fields(self))

    @property
    def windows(self) -> int:
        """Number of windows."""
        return int(self.rows.shape[0])

    @property
    def block_noise(self) -> Array:
        """(5,) standard deviation of the noise of a block mean."""
        return np.asarray(self.noise / np.sqrt(self.rows.shape[2]))

    @property
    def kernel_s(self) -> float:
        """Full width of the kernel (Hann) that differentiates the motion where it is shown and not fitted, s."""
        return KERNEL * self.vehicle.own_time

    @property
    def size(self) -> float:
        """Wheelbase over that of the car that lengths on the road are written down for."""
        return self.vehicle.wheelbase / table_car().wheelbase

    @property
    def block_step(self) -> float:
        """Time between blocks, s."""
        return self.step * float(self.rows.shape[2])

    def thin(self, signal: Array) -> Array:
        """(windows, blocks) block means of an (n,) signal."""
        return np.asarray(signal[self.rows].mean(axis=2))

    def select(self, windows: NDArray[np.bool_]) -> Record:
        """The windows where `windows` is true."""
        return replace(self, rows=self.rows[windows], lap=self.lap[windows])

    @property
    def window_laps(self) -> Ints:
        """(windows,) number of the lap by the log, whatever groups are held out together."""
        return self.lap_of_row[self.rows[:, 0, 0]]

    def every(self, stride: int) -> Record:
        """Every so many windows, the groups that are held out together numbered anew; always the same object."""
        if stride not in self._thinned:
            part = self.select(np.arange(self.windows) % stride == 0)
            number = np.unique(part.lap, return_inverse=True)[1]
            self._thinned[stride] = replace(part, lap=number.astype(np.int64))
        return self._thinned[stride]

    @cached_property
    def _thinned(self) -> dict[int, Record]:
        return {}

    @cached_property
    def inputs(self) -> Array:
        """(k, windows * blocks) block means of smoothed states, steer, drive and `AUXILIARY`; 0 where there is none."""
        zero = np.zeros(self.rows.shape[:2])
        others = (*SIGNALS[len(STATES) :], *AUXILIARY)
        rows = [self.thin(self.signals[n]) if n in self.signals else zero for n in others]
        return np.stack([*self.state_means, *rows]).reshape(len(STATES) + len(rows), -1)

    @cached_property
    def measured_blocks(self) -> Array:
        """(5, windows, blocks) block means of what was measured."""
        return np.stack([self.thin(channel) for channel in self.measured])

    @cached_property
    def state_means(self) -> Array:
        """(3, windows, blocks) block means of the smoothed vx, vy, yaw rate."""
        return np.stack([self.thin(self.signals[n]) for n in STATES])

    @cached_property
    def past(self) -> Past:
        """What effects with memory make of the signals and of the courses of the axles."""
        return Past({**self.signals, **axle_courses(self.signals, self.vehicle)}, self.vehicle, self.thin)

    def basis_over_windows(self, name: str) -> WindowBasis:
        """The basis of a profile over the windows."""
        if name not in self._over_windows:
            matrix = self.bases[name].matrix(self.thin(self.signals[name]).ravel())
            self._over_windows[name] = WindowBasis.of(matrix, self.windows)
        return self._over_windows[name]

    @cached_property
    def _over_windows(self) -> dict[str, WindowBasis]:
        return {}

    @cached_property
    def state_edges(self) -> Array:
        """(3, windows, blocks + 1) the same states at the edges of the blocks."""
        first, after = self.rows[:, :, 0], self.rows[:, -1:, -1] + 1
        edge = np.concatenate([first, after], axis=1)
        return np.stack([0.5 * (self.signals[n][edge - 1] + self.signals[n][edge]) for n in STATES])


def make_record(
    log: DriveLog, vehicle: Vehicle, distrusted: Collection[str] = (), *, vy_displaced: bool = False
) -> Record:
    """Smooth, differentiate inputs, find laps, cut windows; signals in `distrusted` are neither fitted nor causes.

    Noise, knots and the line that track positions refer to come from the laps that are learnt from alone.

    Raises:
        InputError: no uninterrupted stretch long enough.
    """
    cut = _window_rows(log.step, vehicle.own_time)
    window_s = math.prod(cut) * log.step
    signals, stretches = _prepared(log, window_s)
    lap, has_laps = lap_numbers(log, vehicle, window_s)
    windows, window_lap = _cut(log, lap, signals["vx"], signals["vy"], cut)
    learnt = windows[~np.isin(window_lap, scored_laps(window_lap, has_laps))]
    noise, state_error = _noise(log, learnt, stretches, 2 * window_s)
    position, length = track_position(log, lap, has_laps, np.unique(lap[learnt]))
    signals |= {"track_position": position} if has_laps else {}
    _add_causes(signals, log["t"])
    bases = {n: make_basis(n, signals[n][learnt], length) for n in signals if np.ptp(signals[n][learnt]) > 0}
    return Record(
        signals,
        np.stack([log[name] for name in MEASURED]),
        noise,
        np.array([name not in log.derived and name not in distrusted for name in MEASURED]),
        state_error,
        windows,
        window_lap,
        lap,
        log.step,
        length,
        has_laps,
        vehicle,
        tuple(name for name in log.extra if name not in distrusted),
        bases,
        pedals=OF_PEDALS in log.derived.get("drive", ""),
        vy_displaced=vy_displaced and "vy" not in distrusted,
    )


def _prepared(log: DriveLog, window_s: float) -> tuple[dict[str, Array], list[slice]]:
    """Signals of the log, smooth on every stretch that is long enough, and those stretches.

    Raises:
        InputError: there is none.
    """
    signals = {name: np.array(log[name], float) for name in log.columns}
    if "az" in log:
        signals["extra_load"] = np.zeros(len(log))
    long_enough = [s for s in log.segments() if (s.stop - s.start) * log.step > 2 * window_s]
    if not long_enough:
        raise InputError(f"the log has no uninterrupted stretch of {2 * window_s:.2g} s: nothing can be diagnosed")
    for stretch in long_enough:
        _smooth(log, stretch, signals)
    return signals, long_enough


def _add_causes(signals: dict[str, Array], t: Array) -> None:
    """Add what is no column and may explain a residual."""
    if "brake" in signals:
        signals["brake"] = brake_share(signals["brake"])
    for name in ("steer", "drive"):
        signals[f"{name}_rate"] = np.gradient(signals[name], t)
    signals["ay"] = signals["vx"] * signals["yaw_rate"]
    signals["turn_direction"] = np.sign(signals["ay"]) * (np.abs(signals["ay"]) > STRAIGHT_BELOW)


def _smooth(log: DriveLog, rows: slice, signals: dict[str, Array]) -> None:
    """Replace the states of one segment by smoothed ones, and inputs that were measured with noise.

    Where a vertical accelerometer says how hard the road presses, that is an input as well.
    """
    for name, smoothed in _smoothed(log, rows).items():
        signals[name][rows] = smoothed.value
    for name, response in (("steer", "ay"), ("drive", "ax")):
        signals[name][rows] = without_noise(signals[name][rows], _unsmoothed(log, response, rows), log.step)
    if "az" in log:
        signals["extra_load"][rows] = extra_loads(wiener(np.array(log["az"][rows], float), log.step).value)


def _unsmoothed(log: DriveLog, name: str, rows: slice) -> Array:
    """The acceleration `name`; one that was derived by smoothing has lost its fast part, and is derived without."""
    if name not in log.derived:
        return np.array(log[name][rows], float)
    vx, vy, rate = (np.array(log[n][rows], float) for n in STATES)
    along, other = (vx, -vy * rate) if name == "ax" else (vy, vx * rate)
    return np.asarray(np.gradient(along, log.step) + other)


def _smoothed(log: DriveLog, rows: slice) -> dict[str, Smoothed]:
    """The smoothed states of an uninterrupted stretch, in the order of `STATES`."""
    vx, vy, rate, ax, ay = (np.array(log[n][rows], float) for n in ("vx", "vy", "yaw_rate", "ax", "ay"))
    omega = wiener(rate, log.step)
    forward = smoothed_velocity(log, "ax", vx, ax + vy * omega.value, log.step)
    sideways = smoothed_velocity(log, "ay", vy, ay - forward.value * omega.value, log.step)
    return {"vx": forward, "vy": sideways, "yaw_rate": omega}


def _noise(log: DriveLog, learnt: Ints, segments: Sequence[slice], shortest_s: float) -> tuple[Array, Array]:
    """Noise (5,) of the measured channels and error (3,) left in the smoothed states, where it is learnt from.

    `learnt` (windows, ...) are the rows of the windows that fits see. Where none of their runs is as long as
    `shortest_s`, whole `segments` tell.
    """
    rows = np.sort(learnt.ravel())
    runs = [slice(int(run[0]), int(run[-1]) + 1) for run in np.split(rows, np.flatnonzero(np.diff(rows) != 1) + 1)]
    runs = [r for r in runs if (r.stop - r.start) * log.step > shortest_s] or list(segments)
    weight = [run.stop - run.start for run in runs]
    found = [_noise_of(log, run) for run in runs]
    noise, error = (np.sqrt(np.average([part[k] ** 2 for part in found], axis=0, weights=weight)) for k in (0, 1))
    return np.asarray(noise, np.float64), np.asarray(error, np.float64)


def _noise_of(log: DriveLog, rows: slice) -> tuple[Array, Array]:
    states = _smoothed(log, rows)
    noise = {name: s.noise for name, s in states.items()}
    noise |= {name: wiener(np.array(log[name][rows], float), log.step).noise for name in ("ax", "ay")}
    return np.array([noise[n] for n in MEASURED]), np.array([states[n].value_error for n in STATES])


def _window_rows(step: float, own_time: float) -> tuple[int, int]:
    """Rows of a block and blocks of a window, of a log with `step` s from row to row."""
    q = max(1, round(BLOCK * own_time / step))
    return q, max(8, round(WINDOW * own_time / (q * step)))


def _cut(log: DriveLog, lap: Ints, vx: Array, vy: Array, shape: tuple[int, int]) -> tuple[Ints, Ints]:
    """Rows (windows, blocks, q) and lap of every full window inside one lap of one segment, driven and not spun."""
    q, blocks = shape
    size, edge = q * blocks, round(EDGE_S / log.step)
    slowest = SLOWEST * float(np.quantile(vx, 0.95))
    starts: list[int] = []
    for segment in log.segments():
        first, last = segment.start + edge, segment.stop - edge
        cuts = [first, *(np.flatnonzero(np.diff(lap[first:last])) + first + 1).tolist(), last]
        for a, b in itertools.pairwise(cuts):
            starts.extend(range(a, b - size + 1, size))
    driven = (vx > slowest) & ~_lost(vx, vy, slowest, round(GROWS_S / log.step))
    keep = np.array([s for s in starts if driven[s : s + size].all()], dtype=np.int64)
    if len(keep) < WINDOWS_MIN:
        found, least = len(keep) * size * log.step, WINDOWS_MIN * size * log.step
        raise InputError(f"only {found:.0f} s of driving in the log: at least {least:.0f} s are needed")
    rows = keep[:, None] + np.arange(size)
    _, number = np.unique(lap[keep], return_inverse=True)
    return rows.reshape(len(keep), blocks, q), number.astype(np.int64)


def _lost(vx: Array, vy: Array, slowest: float, stride: int) -> NDArray[np.bool_]:
    """(n,) whether a car has spun, or is on the way there: from where its side slip begins to grow until then."""
    spun = np.abs(vy) >= SPUN * vx
    side = np.abs(vy) / np.maximum(vx, slowest)
    lost = spun.copy()
    fast = spun & (np.hypot(vx, vy) > slowest)
    for end in np.flatnonzero(np.diff(fast.astype(int), prepend=0) == 1).tolist():
        start = end
        while start >= stride and side[start - stride] < side[start]:
            start -= stride
        lost[start:end] = True
    return lost


def available(record: Record) -> frozenset[str]:
    """Auxiliary signals the record has."""
    return frozenset(name for name in AUXILIARY if name in record.signals)
