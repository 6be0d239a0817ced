"""What no catalogue effect explains: an empirical term, a regularised spline of one signal acting in one place.

Places where it can act and signals it can depend on are tried against each other by the same held-out evidence
as the catalogue. `grip` and `steer_gain` multiply by what the tyre or the driver does, so they depend on two
signals. The term is a model of the data, not of the physics, and is reported as such.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from estimator.diagnose.basis import Basis
from estimator.diagnose.evidence import Evidence, compare
from estimator.diagnose.fit import Fit
from estimator.diagnose.linearised import Linearised, linearised
from estimator.diagnose.normal import Normal, accumulate
from estimator.diagnose.predict import Predictor
from estimator.diagnose.record import Record
from estimator.diagnose.trial import Setting, warm_start
from estimator.diagnose.workers import Job, fit_each
from estimator.model.effects.base import Effect
from estimator.model.parameters import Parameter
from estimator.model.single_track import Terms
from estimator.model.tyre import Expr

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Place:
    """Where an empirical term acts."""

    stage: str
    hook: Callable[..., None]
    unit: str
    std: float
    channels: tuple[str, ...]
    words: str


def _force_x(terms: Terms, value: Expr) -> None:
    terms.body_x = terms.body_x + terms.vehicle.mass * value


def _force_y(terms: Terms, value: Expr) -> None:
    terms.body_y = terms.body_y + terms.vehicle.mass * value


def _moment(terms: Terms, value: Expr) -> None:
    terms.body_yaw = terms.body_yaw + terms.vehicle.yaw_inertia * value


def _grip(terms: Terms, value: Expr) -> None:
    terms.grip_f, terms.grip_r = terms.grip_f * (1 + value), terms.grip_r * (1 + value)


def _grip_front(terms: Terms, value: Expr) -> None:
    terms.grip_f = terms.grip_f * (1 + value)


def _grip_rear(terms: Terms, value: Expr) -> None:
    terms.grip_r = terms.grip_r * (1 + value)


def _steer(terms: Terms, value: Expr) -> None:
    terms.steer = terms.steer + value


def _steer_gain(terms: Terms, value: Expr) -> None:
    terms.steer = terms.steer * (1 + value)


def _drive_gain(terms: Terms, value: Expr) -> None:
    terms.drive = terms.drive * (1 + value)


def _motion_x(terms: Terms, value: Expr) -> None:
    terms.gravity_x = terms.gravity_x + value


def _motion_y(terms: Terms, value: Expr) -> None:
    terms.gravity_y = terms.gravity_y + value


def _sensor_x(terms: Terms, value: Expr) -> None:
    terms.imu_ax = terms.imu_ax + value


def _sensor_y(terms: Terms, value: Expr) -> None:
    terms.imu_ay = terms.imu_ay + value


PLACES = {
    "force_x": Place("LONGITUDINAL", _force_x, "m/s2", 0.5, ("ax", "vx_dot"), "longitudinal force"),
    "force_y": Place("BODY", _force_y, "m/s2", 0.5, ("ay", "vy_dot"), "lateral force"),
    "moment": Place("BODY", _moment, "rad/s2", 0.3, ("yaw_acc",), "yaw moment"),
    "grip": Place("GRIP", _grip, "1", 0.1, ("ay", "yaw_acc", "vy_dot"), "tyre grip of both axles"),
    "grip_front": Place("GRIP", _grip_front, "1", 0.1, ("ay", "yaw_acc", "vy_dot"), "tyre grip of the front axle"),
    "grip_rear": Place("GRIP", _grip_rear, "1", 0.1, ("ay", "yaw_acc", "vy_dot"), "tyre grip of the rear axle"),
    "steer": Place("INPUT", _steer, "rad", 0.005, ("ay", "yaw_acc", "vy_dot"), "road-wheel angle"),
    "steer_gain": Place("INPUT", _steer_gain, "1", 0.1, ("ay", "yaw_acc", "vy_dot"), "gain of the steering"),
    "drive_gain": Place("INPUT", _drive_gain, "1", 0.1, ("ax", "vx_dot"), "gain of the drive command"),
    "motion_x": Place("MOTION", _motion_x, "m/s2", 0.3, ("vx_dot",), "longitudinal motion, not felt in ax"),
    "motion_y": Place("MOTION", _motion_y, "m/s2", 0.3, ("vy_dot",), "lateral motion, not felt in ay"),
    "sensor_x": Place("SENSOR", _sensor_x, "m/s2", 0.3, ("ax",), "longitudinal accelerometer alone"),
    "sensor_y": Place("SENSOR", _sensor_y, "m/s2", 0.3, ("ay",), "lateral accelerometer alone"),
}  # fmt: skip

SIGNALS = (
    "vx", "ay", "yaw_rate", "vy", "steer", "steer_rate", "drive", "drive_rate", "track_position", "t", "yaw",
    "turn_direction", "throttle", "brake", "gear", "engine_speed", "z",
)  # fmt: skip
SCREENING_STRIDE = 3
"""Screening uses every third window."""
FITTED = 4


def term(place: str, signal: str) -> Effect:
    """The empirical term as an effect whose profile runs over `signal`."""
    p = PLACES[place]
    return Effect(
        name=f"empirical_{place}_{signal}",
        lacks=f"empirical: {p.words} as a function of {signal}",
        equation=f"{place} += spline({signal})",
        source="empirical, fitted to this data",
        parameters=(Parameter("value", p.unit, 0.0, p.std, -50 * p.std, 50 * p.std, p.words),),
        channels=p.channels,
        cause=signal,
        hooks={p.stage: p.hook},
        profile=signal,
    )


@dataclass(frozen=True)
class Term:
    """An empirical term tried on top of a model."""

    place: str
    signal: str
    evidence: Evidence
    fit: Fit | None = None

    @property
    def effect(self) -> Effect:
        """The term as an effect."""
        return term(self.place, self.signal)


def search_terms(
    setting: Setting, accepted: Sequence[str], current: Fit, progress: Callable[[str], None]
) -> list[Term]:
    """Empirical terms by held-out evidence, best first; the most promising fitted to the end."""
    progress("anything else, by any signal")
    screened = _screen(setting, accepted, current)
    before, count = current.held_out(), current.normal.count
    best = screened[:FITTED]
    jobs = [Job(f"spline of {t.signal} in {t.place}", tuple(accepted), (t.effect,)) for t in best]
    fits = fit_each(setting, current, jobs, progress)
    done = [Term(t.place, t.signal, compare(before, f.held_out(), count), f) for t, f in zip(best, fits, strict=True)]
    return sorted(done, key=lambda t: -t.evidence.gain) + screened[FITTED:]


def explanatory(record: Record) -> list[str]:
    """Signals an empirical term may depend on: those the record has, and every extra column."""
    return [n for n in dict.fromkeys((*SIGNALS, *record.extra)) if n in record.bases]


def _screen(setting: Setting, accepted: Sequence[str], current: Fit) -> list[Term]:
    """Predicted evidence of every place and signal from one linearisation at the current fit."""
    thin = np.arange(setting.record.windows) % SCREENING_STRIDE == 0
    if np.unique(setting.record.lap[thin]).size != np.unique(setting.record.lap).size:
        thin[:] = True
    record = current.predictor.record.select(thin)
    predictor, normal_base, parts = _linearise_places(setting, accepted, current, record)
    before = normal_base.held_out(current.normal.variance)
    terms = []
    for signal in explanatory(record):
        basis = record.bases[signal]
        matrix = basis.matrix(record.thin(record.signals[signal]).ravel())
        for places in _groups(basis.size):
            normal = _with_terms(predictor, current, parts, places, basis, matrix)
            base = np.arange(len(current.parameters))
            for k, place in enumerate(places):
                own = len(base) + k * basis.size + np.arange(basis.size)
                after = normal.subset(np.concatenate([base, own])).held_out(current.normal.variance)
                terms.append(Term(place, signal, compare(before, after, normal.count * SCREENING_STRIDE)))
    return sorted(terms, key=lambda t: -t.evidence.gain)


COLUMNS_AT_ONCE = 160


def _groups(size: int) -> list[tuple[str, ...]]:
    """Places handled in one go, so that no more than about `COLUMNS_AT_ONCE` sensitivities are held at once."""
    names, most = tuple(PLACES), max(1, COLUMNS_AT_ONCE // size)
    return [names[i : i + most] for i in range(0, len(names), most)]


_Parts = tuple[Array, Array, Array, Array]


def _linearise_places(
    setting: Setting, accepted: Sequence[str], current: Fit, record: Record
) -> tuple[Predictor, Normal, _Parts]:
    """Predictions, derivatives by states, by parameters, and by a unit at each place, (5, places, w, b)."""
    model = setting.model(accepted)
    points = tuple(replace(term(place, "t"), profile="", name=place) for place in PLACES)
    wide = Predictor(replace(model, effects=(*model.effects, *points)), record)
    start = warm_start(wide, wide.start([p.prior for p in model.tyre_table]), current)
    values, state_by, jacobian = wide.linearise(start)
    size = len(current.parameters)
    parts = (values, state_by, jacobian[:, :size], jacobian[:, size:])
    predictor = Predictor(model, record)
    at = linearised(record, *parts[:3], current.noise)
    normal = _normal(predictor, current, record, at, current.normal.prior)
    return predictor, normal, parts


def _with_terms(  # noqa: PLR0917 - the pieces of one linearisation
    predictor: Predictor, current: Fit, parts: _Parts, places: Sequence[str], basis: Basis, matrix: Array
) -> Normal:
    """Normal equations of the current parameters and the coefficients of one signal's term at each of `places`."""
    values, state_by, jacobian, by_place = parts
    record, shape, size = predictor.record, values.shape[1:], jacobian.shape[1]
    units = by_place[:, [list(PLACES).index(p) for p in places]].reshape(5, len(places), 1, -1)
    columns = (units * matrix.T).reshape(5, -1, *shape)
    at = linearised(record, values, state_by, np.concatenate([jacobian, columns], axis=1), current.noise)
    prior = np.zeros((size + columns.shape[1],) * 2)
    prior[:size, :size] = current.normal.prior
    for k, place in enumerate(places):
        own = slice(size + k * basis.size, size + (k + 1) * basis.size)
        prior[own, own] = basis.precision(PLACES[place].std)
    return _normal(predictor, current, record, at, prior)


def _normal(predictor: Predictor, current: Fit, record: Record, at: Linearised, prior: Array) -> Normal:
    laps = int(record.lap.max()) + 1
    count = np.array([np.count_nonzero(record.lap == lap) for lap in range(laps)]) * float(record.rows.shape[1])
    size = len(current.parameters)
    pull = np.zeros(len(prior))
    pull[:size] = -current.normal.prior @ (current.parameters - np.array([p.prior for p in predictor.table]))
    return Normal(*accumulate(at.error, at.sensitivity, record.lap), count, prior, pull, record.block_noise**2)
