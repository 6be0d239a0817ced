"""By how much the parameters of a fit move with what is held at one value beside them.

The minimum moves by the covariance times sensitivity times the change of the residual. Held are the instants at which
each sensor was read within a row of the log, the numbers of the vehicle file, and beside a bank the zero of the
accelerometer.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from estimator.model.declared_vehicle import DECLARED
from estimator.model.parameters import Quantity
from estimator.offline.fit.prediction_error import Fit, Point, residual
from estimator.offline.predict.predict import Predictor
from estimator.offline.record.record import MEASURED
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.process.arrays import Array

MASS_ERROR, PLACE_ERROR, INERTIA_ERROR = 0.01, 0.01, 0.025
"""Standard deviations of what a vehicle file says: mass, relative, by scales under four wheels and what fuel and driver
weigh; centre of gravity, m, by the axle loads; yaw inertia, relative, by a swing test (95 % within 5 %)"""
ZERO_ERROR = 0.05
"""m/s2; standard deviation of the zero of an accelerometer: 5 mg is what zeroing leaves"""
AY = MEASURED.index("ay")
UNIFORM = 12.0**-0.5
"""Standard deviation of a uniform distribution over its width: when within a row a sensor was read."""
MEASURED_INPUTS = {"vx": 8, "vy": 9, "yaw_rate": 10}
"""Rows of the predictor's inputs (`Linearised.inputs`) of a measured signal less its prediction. When ay was read
is fitted (`unknown_inputs`), and no effect is told by when ax was."""


@lru_cache  # each effect of a fit is judged by the same moves
def by_sampling(fit: Fit) -> Array:
    """(3, p) by which the parameters move where one signal was read by a standard deviation later than the others."""
    if fit.by_sampling is not None:
        return fit.by_sampling
    at = Point.at(fit.predictor, fit.parameters, fit.noise)
    return _moved(at, fit, list(_read_later(at)))


def by_declared(fit: Fit) -> Array:
    """(k, p) by which the parameters move where a number of the vehicle file is off by a standard deviation.

    A number that is fitted has its error in the fit.
    """
    at = Point.at(fit.predictor, fit.parameters, fit.noise)
    record, model = at.predictor.record, at.predictor.model
    fitted = {DECLARED[e.name].name for e in model.effects if e.name in DECLARED}
    errors = []
    for name, other in _other_vehicles(record.vehicle).items():
        if name not in fitted:
            off = Predictor(replace(model, vehicle=other), replace(record, vehicle=other))
            errors.append(residual(off, at.parameters, at.noise) - at.left.error)
    return _moved(at, fit, errors)


def by_zero(fit: Fit) -> Array:
    """(k, p) by which a bank and what it loads move where the zero of the lateral accelerometer is off unnamed.

    k is 0 where there is no bank, no such sensor, or the zero is in the fit.
    """
    banked, zeroed = (fit.predictor.model.place_of(q) is not None for q in (Quantity.BANK, Quantity.LATERAL_ZERO))
    if not banked or zeroed or not fit.predictor.record.used[AY]:
        return np.zeros((0, len(fit.parameters)))
    at = Point.at(fit.predictor, fit.parameters, fit.noise)
    error = np.zeros_like(at.left.error)
    error[AY] = ZERO_ERROR
    return _moved(at, fit, [error])


def _moved(at: Point, fit: Fit, errors: Sequence[Array]) -> Array:
    """(k, p) steps of the minimum for changes (5, windows, blocks) of the residual."""
    sensitivity, weight = at.sensitivity, 1.0 / fit.normal.variance[:, None, None]
    return np.stack([fit.covariance @ sensitivity.times(error * weight) for error in errors])


def _read_later(at: Point) -> Iterator[Array]:
    """(5, windows, blocks) change of the residual where one channel was read by a standard deviation later."""
    record, predicted = at.predictor.record, at.predictor.predict(at.parameters)
    for signal, row in MEASURED_INPUTS.items():
        inputs = np.zeros_like(at.left.inputs)
        inputs[:, :, row, 0] = record.step * UNIFORM * predicted[MEASURED.index(signal)].T
        yield at.left.innovations.run(inputs)[..., 0].transpose(2, 1, 0)


def _other_vehicles(vehicle: Vehicle) -> dict[str, Vehicle]:
    """The vehicle with one number off by its standard deviation; the wheelbase stays."""
    changes = {
        "mass": {"mass": vehicle.mass * (1 + MASS_ERROR)},
        "lf": {"lf": vehicle.lf + PLACE_ERROR, "lr": vehicle.lr - PLACE_ERROR},
        "yaw_inertia": {"yaw_inertia": vehicle.yaw_inertia * (1 + INERTIA_ERROR)},
    }
    return {name: vehicle.model_copy(update=change) for name, change in changes.items()}
