"""Live watch over the model: where has it stopped explaining what the car does, and which effect would?

Residuals of specific forces and yaw acceleration against the model now believed are averaged in cells: turn direction
or pedal, by speed band. A cell whose mean, on repeated visits, leaves behind the noise floor and what belief and state
filter say that they do not know yet raises an alert. The suspect is found by a score test (Rao 1948): how much of the
recent residual would one Gauss-Newton step in the parameters of each effect of the catalogue explain beyond what a
re-tuned belief already does. Constant work a sample.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from math import inf, isfinite, sqrt
from typing import NamedTuple

import casadi as ca
import numpy as np

from estimator.belief.tyre_belief import Sample, measured_std, plausible
from estimator.model.effect import Effect
from estimator.model.effects import catalogue
from estimator.model.measurement import compiled_for, measurement, of_any_car
from estimator.model.single_track import AUXILIARY, SIGNALS, SingleTrack
from hil_gateway.process.arrays import Array

DECIMATION = 4
"""residuals are looked at on every fourth sample"""
WINDOW = 500
"""looks a cell remembers: 20 s spent in it"""
MOST = 1e3
"""m/s2 and rad/s2: a residual beyond says that numbers broke, not by how much"""
UNREAD = 25
"""looks kept for `residual`: 1 s, where nobody asks more often"""
SCORE_WINDOW = 3000
"""looks the score test remembers: two minutes"""
MIN_LOOKS, MIN_VISITS = 40, 2
VISIT_GAP = 25
"""looks elsewhere after which coming back is a new visit"""
RATIO = 3.0
"""mean residual over its deviation, by noise floor and belief, that raises an alert"""
REPEAT_NS = 60_000_000_000
"""the same alert is not repeated for a minute"""
EXPLAINED = 0.25
"""least share of the residual left by the others that a suspect must explain"""
MOST_SUSPECTS = 3
"""effects suspected at once: a score test of a linearised model says no more than that"""
SMALLEST: Mapping[str, float] = {"ax": 0.1, "ay": 0.1, "yaw_acc": 0.08}
"""noise floors are not believed below these, m/s2 and rad/s2"""

SPEED_BANDS = ((25.0, "below 25 m/s"), (40.0, "between 25 and 40 m/s"), (np.inf, "above 40 m/s"))
TURNING = 3.0
"""lateral acceleration that makes a turn, m/s2"""
PEDAL = 0.01
"""drive command that counts as driving or braking"""


@dataclass(frozen=True)
class ModelAlert:
    """What an alert says; `strength` is the residual's RMS over its noise floor."""

    channel: str
    condition: str
    suspected_effect: str
    strength: float


class Doubt(NamedTuple):
    """Variance of a residual by what the belief, and what the state filter, say of themselves."""

    belief: float
    state: float


@dataclass
class _Cell:
    looks: int = 0
    visits: int = 0
    last_look: int = -VISIT_GAP - 1
    mean: float = 0.0
    square: float = 0.0
    doubt: Doubt = field(default_factory=lambda: Doubt(0.0, 0.0))
    judged_ns: int | None = None

    def add(self, residual: float, doubt: Doubt, look: int) -> None:
        self.visits += look - self.last_look > VISIT_GAP
        self.last_look = look
        self.looks += 1
        gain = 1.0 / min(self.looks, WINDOW)
        self.mean += gain * (residual - self.mean)
        self.square += gain * (residual * residual - self.square)
        self.doubt = Doubt(*(old + gain * (new - old) for old, new in zip(self.doubt, doubt, strict=True)))

    def std(self, floor: float) -> float:
        """Deviation of the mean: errors of the belief last, those of the state are others on every visit."""
        return sqrt(floor**2 + self.doubt.belief + self.doubt.state / max(self.visits, 1))


@dataclass
class _NoiseFloor:
    """White noise of each channel from second differences, which know nothing of slow signals."""

    last: deque[list[float]] = field(default_factory=lambda: deque(maxlen=3))
    variance: list[float] = field(default_factory=lambda: [0.0] * 3)
    count: int = 0

    def add(self, z: list[float]) -> None:
        self.last.append(z)
        if len(self.last) == 3:
            self.count += 1
            for i, (a, b, c) in enumerate(zip(*self.last, strict=True)):
                # clipped: a kerb or a shift is not noise
                limit = 9.0 * self.variance[i] if self.count > 100 else inf
                change = min((a - 2 * b + c) ** 2 / 6.0, limit) - self.variance[i]
                self.variance[i] += change / min(self.count, 2000)

    def std(self) -> list[float]:
        return [max(sqrt(variance), least) for variance, least in zip(self.variance, SMALLEST.values(), strict=True)]


class ResidualMonitor:
    """`push` every belief sample (kind `imu_yaw`); returns what is newly wrong with the model, mostly nothing."""

    def __init__(self, model: SingleTrack) -> None:
        self._score = _ScoreTest(model)
        self._cells: dict[tuple[str, str], _Cell] = {}
        self._noise = _NoiseFloor()
        self._alerted_ns: dict[tuple[str, str], int] = {}
        self._count = self._looks = 0
        self._unread: list[list[float]] = []

    def residual(self) -> tuple[float, float, float] | None:
        """Mean residual of ax, ay (m/s2) and yaw acceleration (rad/s2) since the last call; None where nothing came."""
        looks, self._unread = self._unread, []
        if not looks:
            return None
        ax, ay, yaw_acc = np.clip(np.mean(looks, axis=0), -MOST, MOST).tolist()
        return ax, ay, yaw_acc

    def push(self, sample: Sample, theta: Array, covariance: Array, stamp_ns: int) -> list[ModelAlert]:
        """Take in one sample with the tyre parameters now believed, and the covariance of them and of the effects."""
        if not plausible(sample):
            return []
        self._noise.add(sample.z.tolist())
        self._count += 1
        if self._count % DECIMATION or sample.signals[0] < 8.0:
            return []
        self._looks += 1
        residual, doubts = self._score.add(sample, theta, covariance)
        self._unread = [*self._unread[1 - UNREAD :], residual]
        for channel, value, doubt in zip(SMALLEST, residual, doubts, strict=True):
            key = (channel, _condition(channel, sample))
            self._cells.setdefault(key, _Cell()).add(value, doubt, self._looks)
        return self._findings(sample, stamp_ns)

    def _findings(self, sample: Sample, stamp_ns: int) -> list[ModelAlert]:
        """Alerts due in the cells just visited."""
        findings = []
        for channel, floor in zip(SMALLEST, self._noise.std(), strict=True):
            condition = _condition(channel, sample)
            cell = self._cells[channel, condition]
            if cell.looks < MIN_LOOKS or cell.visits < MIN_VISITS or abs(cell.mean) < RATIO * cell.std(floor):
                continue
            if cell.judged_ns is not None and stamp_ns - cell.judged_ns < REPEAT_NS:
                continue
            cell.judged_ns = stamp_ns
            suspect = self._score.suspect(channel)
            key = channel, suspect or condition  # an effect is said once, wherever it shows; else every place is news
            if key in self._alerted_ns and stamp_ns - self._alerted_ns[key] < REPEAT_NS:
                continue
            self._alerted_ns[key] = stamp_ns
            findings.append(ModelAlert(channel, condition, suspect, float(np.sqrt(cell.square) / floor)))
        return findings


def _condition(channel: str, sample: Sample) -> str:
    """The cell a sample falls into, in words: by pedal for ax, by turn direction for the lateral channels."""
    vx, drive = float(sample.signals[0]), float(sample.signals[4])
    band = next(words for limit, words in SPEED_BANDS if vx < limit)
    if channel == "ax":
        where = "driving" if drive > PEDAL else "braking" if drive < -PEDAL else "coasting"
    else:
        ay = float(sample.z[1])
        where = "left turns" if ay > TURNING else "right turns" if ay < -TURNING else "straights"
    return f"{where} {band}"


class _ScoreTest:
    """Discounted normal equations of the residual on the sensitivities of tyres and candidate effects."""

    def __init__(self, model: SingleTrack) -> None:
        known = {effect.name for effect in model.effects}
        others = (e for e in catalogue().values() if e.name not in known and not e.estimated_by_filter)
        self._candidates = [effect for effect in others if not effect.profile]
        widened = SingleTrack(model.vehicle, model.tyre_prior, (*model.effects, *self._candidates))
        self._function = compiled_for(model.vehicle, _sensitivities(widened))
        self._neutral = np.array([x for e in self._candidates for x in e.neutral()])
        believed = [*model.tyre_table, *model.effect_table]
        self._scale = np.array([p.prior_std for p in [*believed, *(p for e in self._candidates for p in e.parameters)]])
        self._believed = list(range(len(believed)))
        self._columns = self._columns_of(self._candidates)
        self._channels = {effect.name: effect.channels for effect in self._candidates}
        n = len(self._scale)
        self._gram, self._moment, self._count = np.zeros((3, n, n)), np.zeros((3, n)), 0
        self._change = np.empty_like(self._gram)
        self._energy = np.zeros(3)
        self._std = np.array(measured_std("imu_yaw", model.vehicle.mass))

    def _columns_of(self, effects: list[Effect]) -> dict[str, list[int]]:
        columns, start = {}, len(self._believed)
        for effect in effects:
            columns[effect.name] = list(range(start, start + len(effect.parameters)))
            start += len(effect.parameters)
        return columns

    def add(self, sample: Sample, theta: Array, covariance: Array) -> tuple[list[float], list[Doubt]]:
        """Residual of the three channels, m/s2 and rad/s2, and its doubts; also accumulated."""
        signals, aux, tyres, phi, _ = self._function.arguments
        signals[:], aux[:], tyres[:], phi[:] = sample.signals, sample.aux, theta, [*sample.phi, *self._neutral]
        self._function.evaluate()
        h, sensitivity, motion = self._function.results
        residual = sample.z - h
        if np.isfinite(residual).all() and np.isfinite(sensitivity).all():
            self._accumulate(residual / self._std, sensitivity * self._scale / self._std[:, None])
        by_belief = _variances(sensitivity[:, : len(covariance)], covariance)
        by_state = _variances(motion, sample.signal_covariance)
        return _numbers(residual.tolist()), [Doubt(*pair) for pair in zip(by_belief, by_state, strict=True)]

    def _accumulate(self, r: Array, J: Array) -> None:
        self._count += 1
        gain = 1.0 / min(self._count, SCORE_WINDOW)
        change = np.multiply(J[:, :, None], J[:, None, :], out=self._change)
        change -= self._gram
        change *= gain
        self._gram += change
        self._moment += gain * (J * r[:, None] - self._moment)
        self._energy += gain * (r * r - self._energy)

    def suspect(self, channel: str) -> str:
        """Effect acting on `channel` among those that together explain the residuals; empty where none of them does."""
        return next((name for name in self._suspects() if channel in self._channels[name]), "")

    def _suspects(self) -> list[str]:
        """Effects by what each explains beyond the belief and the ones before it, all channels together.

        Taken one after the other, so that nothing is suspected of what another effect explains already.
        """
        chosen: list[str] = []
        columns, total = list(self._believed), float(np.sum(self._energy))
        while len(chosen) < MOST_SUSPECTS:
            explained = self._explained(columns)
            gains = {
                name: (self._explained(columns + own) - explained) / max(total - explained, 1e-9)
                for name, own in self._columns.items()
                if name not in chosen
            }
            best = max(gains, key=lambda name: gains[name], default="")
            if not best or gains[best] <= EXPLAINED:
                break
            chosen.append(best)
            columns += self._columns[best]
        return chosen

    def _explained(self, columns: list[int]) -> float:
        """Residual energy explained by one regularised Gauss-Newton step in `columns`."""
        G = self._gram.sum(axis=0)[np.ix_(columns, columns)]
        b = self._moment.sum(axis=0)[columns]
        ridge = 1e-6 * max(float(np.trace(G)), 1e-12)
        return float(b @ np.linalg.solve(G + ridge * np.eye(len(columns)), b))


def _sensitivities(model: SingleTrack) -> ca.Function:
    """(signals, aux, theta, phi, car) -> h (3), dh/d(theta, phi), dh/d(vx, vy, yaw_rate)."""
    model, vehicle = of_any_car(model)
    signals, aux = ca.SX.sym("signals", len(SIGNALS)), ca.SX.sym("aux", len(AUXILIARY))
    theta, phi = ca.SX.sym("theta", len(model.tyre_table)), ca.SX.sym("phi", len(model.effect_table))
    named = dict(zip(AUXILIARY, ca.vertsplit(aux), strict=True))
    h = measurement(model, "imu_yaw", ca.vertsplit(signals), ca.vertsplit(theta), ca.vertsplit(phi), aux=named)
    by = ca.jacobian(h, ca.vertcat(theta, phi)), ca.jacobian(h, signals)[:, :3]
    return ca.Function("sensitivities", [signals, aux, theta, phi, vehicle], [h, *by])


def _numbers(values: list[float]) -> list[float]:
    """Zero for what is none."""
    return values if all(map(isfinite, values)) else np.nan_to_num(values).tolist()


def _variances(jacobian: Array, covariance: Array) -> list[float]:
    """Variance of each row of what is linear in something of this covariance; zero where numbers broke."""
    found: list[float] = ((jacobian @ covariance) * jacobian).sum(axis=1).tolist()
    return _numbers(found)
