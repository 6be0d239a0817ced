"""Bank and grade of the road from kinematics, before any tyre is fitted.

For any tyre, d/dt vy + vx omega - ay = -g sin(bank) and d/dt vx - vy omega - ax = -g sin(grade): gravity moves the car
and is not felt. What the sensors add (offset, roll and turn of the accelerometer, its place, errors of speed and yaw
rate) follows the motion; what the road adds repeats over track position, at any speed. Both are fitted together, and a
road is there where it predicts laps that it was not fitted to. Where that shows no bank, the roll of the body may
(`roll`): in steep bends an accelerometer with a gain of its own looks much the same.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from estimator.model.basis import Basis
from estimator.model.effects import effect_with
from estimator.model.parameters import Quantity
from estimator.offline.record.record import MEASURED, Record, RoadProfile
from estimator.offline.record.roll import ROLL_PRIORS, ROLL_STD, ROLL_STRAIGHT, bank_by_roll, no_surer_than_roll
from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.process.arrays import Array, Ints

PRIOR_STD = 0.4
"""rad; of a bank or grade anywhere: the steepest speedways, so that a bank of all turns is not taken for an offset"""
STRAIGHT_SHARE = 0.2
"""Below this share of the track's sharp curvature (95th percentile) the road is straight."""
STRAIGHT_BANK = 0.02
"""rad, of the mean over all straights (drainage 0.01, tri-ovals up to 0.16): shares a constant between bank and the
accelerometer's offset; a weak hint, since which of both it is the tyres tell later"""
CLOSED = 1e-4
"""rad; mean grade of a lap that ends at the height where it began"""
SENSORS: Mapping[str, float] = {
    "offset": 0.2, "gain": 0.05, "turn": 0.05, "arm": 1.0, "arm_square": 1.0, "gyro": 0.01,
}  # fmt: skip
"""Prior standard deviations: m/s2, 1, rad, m, m, rad/s; wider than what is built into cars (data sheets). The gain also
stands for an error of speed: with both, vx omega - ay, which is the bank itself, would be taken for sensors."""
SLOW_BLOCKS = 5
"""Blocks (0.2 s) over which residuals are averaged, for an information that does not count correlated noise twice."""
LEAST_ANGLE = 0.005
"""rad; half the range over the lap: body pitch and roll on the springs repeat by about 0.002 on a flat course"""
LEAST_LAPS = 2
"""One predicts the other: no tyre is in the equation, so that only a road repeats. A bank left to the fit of the tyres
because of too few laps comes out at half its size."""
LEAST_GAIN = 0.02
"""Log-likelihood per block, on laps held out: a fifth of the noise, as for any effect of the search"""
LEAST_GAINING = 0.8
"""Share of the laps that must be predicted better."""


@dataclass(frozen=True)
class _Kinematics:
    """One component of gravity in the blocks: y (w, b) m/s2, what the sensors may add (w, b, k), prior std (k,)."""

    y: Array
    sensors: Array
    std: Array


FINE_M, FINE_STD = 20.0, 0.05
"""Distance of the knots by which a roll channel follows a bank, m: transitions of ovals are 50 m and longer; and what a
profile with wide knots is off by there, rad"""
PEDALS = ("drive", "throttle", "brake")
"""What the driver asks for along the car; either sign of each has its own force."""
ANY_FORCE = 100.0
"""m/s2 (rms) of each force that may act along the car: more than any does"""
SHOWN_BY = {Quantity.BANK: ("ay", "vy"), Quantity.GRADE: ("ax", "vx")}
"""What of `record.MEASURED` says without any tyre whether there is a bank or a grade."""


def find_road(record: Record) -> dict[str, RoadProfile]:
    """Bank and grade by effect, where accelerometer and velocities of the `record`'s laps show them.

    A bank needs straights: on an open circle it is the sensor's zero.
    """
    if "track_position" not in record.bases or len(np.unique(record.lap)) < LEAST_LAPS:
        return {}
    straights = bool(_is_straight(record).any())
    bank = _shown(record, Quantity.BANK, _straights(record)) if straights else None
    if bank is None and straights:
        bank = _by_roll(record)
    found = {Quantity.BANK: bank, Quantity.GRADE: _shown(record, Quantity.GRADE, None)}
    return {effect_with(slope).name: profile for slope, profile in found.items() if profile is not None}


def _shown(record: Record, slope: Quantity, straight: tuple[float, float] | None) -> RoadProfile | None:
    """Bank or grade by kinematics (`straight`: see `_profile`)."""
    kinematics = _of(record, slope)
    return None if kinematics is None else _profile(record, kinematics, straight)


def _straights(record: Record) -> tuple[float, float]:
    """Mean bank of the straights and its standard deviation, rad: level, or as a roll channel of a steep oval says."""
    rolled = bank_by_roll(record)
    if rolled is None:
        return 0.0, STRAIGHT_BANK
    sine = -float(rolled[0][_is_straight(record)].mean()) / GRAVITY
    return float(np.arcsin(np.clip(sine, -0.9, 0.9))), float(np.hypot(ROLL_PRIORS[0] / GRAVITY, ROLL_STD))


def _is_straight(record: Record) -> NDArray[np.bool_]:
    """(windows, blocks) where the track hardly bends."""
    vx, _, rate = record.state_means
    curvature = np.abs(rate / np.maximum(vx, 1.0))
    return np.asarray(curvature < STRAIGHT_SHARE * np.quantile(curvature, 0.95))


def share_in_kinematics(record: Record, slope: Quantity, coefficients: Array) -> float | None:
    """Factor on a bank or grade with these `coefficients` (n,) at which kinematics agree best; None where none tell.

    Without a sensor of ax a grade is told from d/dt vx beside any force that follows speed, pedals and bends: a force
    that the model lacks comes back at its place as often as the driver does what he did there.
    """
    kinematics = _of(record, slope)
    if kinematics is None and slope is Quantity.GRADE:
        kinematics = _with_forces(record)
    if kinematics is None:
        return None
    angle = record.basis_over_windows("track_position").at(coefficients)
    X = np.column_stack([-GRAVITY * np.sin(angle), kinematics.sensors.reshape(len(angle), -1)])
    y = kinematics.y.ravel()
    variance = _slow_variance((y - X @ np.linalg.lstsq(X, y, rcond=None)[0]).reshape(kinematics.y.shape))
    known = np.diag([0.0, *(1.0 / kinematics.std**2)])
    return float(np.linalg.solve(X.T @ X / variance + known, X.T @ y / variance)[0])


def _of(record: Record, slope: Quantity) -> _Kinematics | None:
    """The component of gravity that a bank or grade gives, where sensors of their own show it."""
    if not all(record.used[MEASURED.index(name)] for name in SHOWN_BY[slope]):
        return None
    return _lateral(record) if slope is Quantity.BANK else _longitudinal(record)


def _by_roll(record: Record) -> RoadProfile | None:
    """The bank that the body's roll shows, where it is logged."""
    signals = bank_by_roll(record)
    if signals is None:
        return None
    lean, felt = signals
    kinematics = _Kinematics(lean, np.stack([np.ones_like(lean), felt], axis=-1), np.array(ROLL_PRIORS))
    profile = _profile(record, kinematics, (0.0, ROLL_STRAIGHT))
    return None if profile is None else no_surer_than_roll(profile)


def finer_by_roll(record: Record, bank: Array) -> tuple[Basis, Array] | None:
    """What the roll channel shows beyond a `bank` (windows, blocks), rad: a basis over the lap and its coefficients.

    None without such a channel. A steep bank rises within less than the knots of a profile that is fitted with tyres.
    What is left of it is small and of either sign, so that its prior does not move the level of the whole.
    """
    signals = bank_by_roll(record)
    if signals is None:
        return None
    lean, felt = signals
    coarse = record.bases["track_position"]
    basis = replace(coarse, size=max(coarse.size, round(coarse.period / FINE_M)))
    sensors = np.stack([np.ones_like(lean), felt], axis=-1)
    kinematics = _Kinematics(lean + GRAVITY * np.sin(bank), sensors, np.array(ROLL_PRIORS))
    B = basis.matrix(record.thin(record.signals["track_position"]).ravel())
    nothing, prior = np.zeros(basis.size), basis.precision(GRAVITY * FINE_STD)
    found = _Regression.make(kinematics, B, prior, nothing, record.lap).solve()
    return basis, -found[: basis.size] / GRAVITY


def _lateral(record: Record) -> _Kinematics:
    (vx, _, rate), (ax, ay), change = _motion(record)
    return _kinematics(change[1] + vx * rate - ay, (ay, ax, change[2], rate**2, vx))


def _longitudinal(record: Record) -> _Kinematics:
    (_, vy, rate), (ax, ay), change = _motion(record)
    return _kinematics(change[0] - vy * rate - ax, (ax, ay, change[2], rate**2, vy))


def _with_forces(record: Record) -> _Kinematics:
    """d/dt vx with forces, each of any size, in place of what sensors add."""
    (vx, vy, rate), _, change = _motion(record)
    signals = {n: record.thin(record.signals[n]) for n in (*PEDALS, "drive_rate") if n in record.signals}
    parts = [part for n in PEDALS if n in signals for part in (signals[n].clip(min=0.0), signals[n].clip(max=0.0))]
    by_pedals = [column for part in parts for column in (part, part * vx, part**2)]
    columns = [np.ones_like(vx), vx, vx**2, rate**2, (vx * rate) ** 2, signals["drive_rate"], *by_pedals]
    scaled = [column / max(float(np.sqrt(np.mean(column**2))), np.finfo(float).tiny) for column in columns]
    return _Kinematics(change[0] - vy * rate, np.stack(scaled, axis=-1), np.full(len(columns), ANY_FORCE))


def _motion(record: Record) -> tuple[Array, Array, Array]:
    """States (3, w, b), ax and ay (2, w, b), derivatives of the states (3, w, b)."""
    return record.state_means, record.measured_blocks[:2], np.diff(record.state_edges, axis=2) / record.block_step


def _kinematics(y: Array, columns: tuple[Array, ...]) -> _Kinematics:
    """`columns` are what `SENSORS` multiply, but for the constant offset."""
    return _Kinematics(y, np.stack([np.ones_like(y), *columns], axis=-1), np.array(list(SENSORS.values())))


def _profile(record: Record, kinematics: _Kinematics, straight: tuple[float, float] | None) -> RoadProfile | None:
    """The road's component, if laps left out in turn say that there is one.

    `straight`: mean of its straights and how well that is known, rad; None for a grade, which adds up to nothing over a
    lap.
    """
    basis = record.bases["track_position"]
    position = record.thin(record.signals["track_position"])
    B = basis.matrix(position.ravel())
    mean, pull = _level(record, basis, position, straight)
    prior = basis.precision(GRAVITY * PRIOR_STD) + np.outer(mean, mean)
    with_road = _Regression.make(kinematics, B, prior, pull * mean, record.lap)
    without = _Regression.make(kinematics, B[:, :0], prior[:0, :0], mean[:0], record.lap)
    before, after = without.held_out(), with_road.held_out()
    gain = 0.5 * np.log(before.sum() / after.sum())
    if gain < LEAST_GAIN or np.mean(after < before) < LEAST_GAINING:
        return None
    profile = replace(_as_angle(with_road, basis), confidence=_confidence(before - after))
    return profile if 0.5 * np.ptp(profile.coefficients) > LEAST_ANGLE else None


def _confidence(gains: Array) -> float:
    """Student t over laps."""
    from scipy.special import stdtr

    spread = float(gains.std(ddof=1)) / np.sqrt(len(gains))
    return min(0.999, float(stdtr(len(gains) - 1, float(gains.mean()) / max(spread, 1e-9))))


def _level(record: Record, basis: Basis, position: Array, straight: tuple[float, float] | None) -> tuple[Array, float]:
    """Row (n,) that is the profile's mean over its standard deviation, and what it is known to be.

    A lap's grade adds up to nothing; of a bank the straights are known.
    """
    if straight is None:
        everywhere = basis.matrix(np.linspace(0.0, basis.period, 4 * basis.size, endpoint=False))
        return everywhere.mean(axis=0) / (GRAVITY * CLOSED), 0.0
    mean, std = straight
    return basis.matrix(position[_is_straight(record)]).mean(axis=0) / (GRAVITY * std), -np.sin(mean) / std


@dataclass(frozen=True)
class _Regression:
    """Ridge regression of a gravity component, normal equations per lap: (laps, p, p), (laps, p), (laps,).

    `precision` (p, p) and `known` (p,) are those of the prior.
    """

    hessian: Array
    pull: Array
    squares: Array
    precision: Array
    known: Array
    variance: float
    road: int

    @classmethod
    def make(cls, kinematics: _Kinematics, B: Array, prior: Array, known: Array, lap: Ints) -> _Regression:
        k, n = kinematics.sensors.shape[-1], B.shape[1]
        X = np.concatenate([B.reshape(*kinematics.y.shape, n), kinematics.sensors], axis=-1)
        precision = np.zeros((n + k, n + k))
        precision[:n, :n], precision[n:, n:] = prior, np.diag(1.0 / kinematics.std**2)
        own = [lap == number for number in np.unique(lap)]
        H = np.array([np.einsum("wbi,wbj->ij", X[o], X[o], optimize=True) for o in own])
        g = np.array([np.einsum("wbi,wb->i", X[o], kinematics.y[o]) for o in own])
        squares = np.array([np.sum(kinematics.y[o] ** 2) for o in own])
        solved = np.linalg.lstsq(H.sum(0), g.sum(0), rcond=1e-10)[0]
        pull = np.concatenate([known, np.zeros(k)])
        return cls(H, g, squares, precision, pull, _slow_variance(kinematics.y - X @ solved), n)

    def solve(self, without: int | None = None) -> Array:
        """Coefficients (p,) of all laps, or of all but one."""
        own = np.arange(len(self.squares)) != (-1 if without is None else without)
        total = self.hessian[own].sum(0) / self.variance + self.precision
        return np.linalg.solve(total, self.pull[own].sum(0) / self.variance + self.known)

    def held_out(self) -> Array:
        """(laps,) squares of each lap predicted by the others."""
        left = [self.solve(lap) for lap in range(len(self.squares))]
        each = zip(left, self.hessian, self.pull, self.squares, strict=True)
        return np.array([s - 2 * c @ g + c @ H @ c for c, H, g, s in each])

    @property
    def information(self) -> Array:
        """(n, n) about the road's coefficients when what the sensors add is unknown: the Schur complement."""
        total, n = self.hessian.sum(0) / self.variance + self.precision, self.road
        return np.asarray(total[:n, :n] - total[:n, n:] @ np.linalg.solve(total[n:, n:], total[n:, :n]))


def _slow_variance(residual: Array) -> float:
    """Variance of white noise with the same averages over 0.2 s as the residual (w, b)."""
    blocks = residual.shape[1] // SLOW_BLOCKS * SLOW_BLOCKS
    averages = residual[:, :blocks].reshape(len(residual), -1, SLOW_BLOCKS).mean(axis=2)
    return float(max(SLOW_BLOCKS * np.mean(averages**2), np.mean(residual**2)))


def _as_angle(regression: _Regression, basis: Basis) -> RoadProfile:
    """Coefficients of the angle from those of -g sin(angle), and their information."""
    at = np.linspace(0.0, basis.period, 8 * basis.size, endpoint=False)
    B = basis.matrix(at)
    sine = np.clip(-(B @ regression.solve()[: regression.road]) / GRAVITY, -0.9, 0.9)
    coefficients = np.asarray(np.linalg.lstsq(B, np.arcsin(sine), rcond=None)[0], np.float64)
    slope = GRAVITY * np.cos(coefficients)
    return RoadProfile(coefficients, regression.information * np.outer(slope, slope))
