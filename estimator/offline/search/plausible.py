"""What a fit may be believed: sizes in a plausible range, off the bounds, and larger than the data's uncertainty.

Anything else is no finding, whatever it gains: it stands in for something else, and that is left unexplained.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache

import numpy as np

from estimator.model.parameters import Parameter, Quantity
from estimator.offline.fit.fixed_parameters import by_sampling
from estimator.offline.fit.prediction_error import Fit
from estimator.offline.health.finding import LEAST_ERRORS
from estimator.offline.predict.predict import Block
from estimator.offline.record.road import LEAST_ANGLE, share_in_kinematics
from estimator.offline.search.sensor_place import (
    YAW_RATE,
    accelerometer_ahead,
    gyro_gain,
    gyroscope_zero,
    speed_scale,
)
from hil_gateway.process.arrays import Array

CONTRADICTED = 4.0
"""Standard errors by which two halves of the data may differ whatever their signs."""
LEAST_STRETCHES = 4
"""of 30 s, for halves to be compared"""
CONFIRMED_SHARE = 0.5
"""of the accelerometer's place, or of a road, by which kinematics may be off beyond error: sensors differ in timing"""
CLOCK = 0.01
"""share by which the speed of positions may be off besides: a logger that drops rows unseen stretches its time"""
LEVEL = 0.01
"""rad; mean grade beyond which a lap does not end at the height where it began: 10 m a km"""
CLOSED_SHARE = 0.25
"""of the range of a grade, that its mean must stay below: one that mostly climbs is a force, as drag is at one speed"""
LOWEST, HIGHEST = 0.04, 0.2
"""Height of the centre of gravity over the wheelbase: half of that of the flattest cars, open-wheel ones (0.08), and
that of road cars (0.55 m over 2.7 m)"""
ON_BOUND = 1e-6
"""Share of a parameter's range within which it is on its bound: steps that would leave it end just there."""


@lru_cache  # a trial is judged each time that more are tried beside it
def believed(fit: Fit, name: str) -> bool:
    """Whether an effect is more than the log's sampling, physically possible, there, alike in both halves, and not
    contradicted by kinematics."""
    block = next(b for b in fit.predictor.blocks if b.effect.name == name)
    alone = all(check(fit, block) for check in (possible, _there, _agrees))
    return alone and not _within_a_sample(fit, block) and _confirmed(fit, block)


def _within_a_sample(fit: Fit, block: Block) -> bool:
    """Whether it is a lag so short that the sampling of the log explains it; a length counts at the mean speed."""
    if not block.effect.lags:
        return False
    record = fit.predictor.record
    speed = float(record.signals["vx"][record.rows].mean()) if block.effect.parameters[0].unit == "m" else 1.0
    return abs(float(fit.parameters[block.parameters][0])) < record.step * speed


def there(fit: Fit, name: str) -> bool:
    """Whether an effect is off its neutral value beyond its error."""
    return _there(fit, next(b for b in fit.predictor.blocks if b.effect.name == name))


def possible(fit: Fit, block: Block) -> bool:
    """Whether every parameter lies in its plausible range, and off its bounds unless a bound is the neutral value."""
    for p, value in zip(_table(fit, block), fit.parameters[block.parameters], strict=True):
        if p.plausible is not None and not p.plausible.lower <= value <= p.plausible.upper and value != p.prior:
            return False
        edge = ON_BOUND * (p.upper - p.lower)
        if any(abs(value - bound) < edge and bound != p.prior for bound in (p.lower, p.upper)):
            return False
    return True


def _there(fit: Fit, block: Block) -> bool:
    """Whether a parameter that tells is off its neutral value beyond its error and any healthy part; a profile: its
    largest.

    When each sensor was read within a row of the log is part of the error: a sensor displaced, tyres or a force that
    lag may be no more than that. The jackknife of what is stated at the end is not: while other effects are missing,
    they move a size whenever a stretch is left out.
    """
    rows, table = block.parameters, _table(fit, block)
    off = np.abs(fit.parameters[rows] - np.array([p.prior for p in table]))
    least = np.array([0.0 if p.plausible is None else p.plausible.least for p in table])
    errors = np.sqrt(
        (np.maximum(np.diag(fit.covariance), fit.slow_variance) + np.sum(by_sampling(fit) ** 2, axis=0))[rows]
    )
    beyond = off > np.maximum(LEAST_ERRORS * np.maximum(errors, np.finfo(float).tiny), least)
    return bool(np.any(beyond[[p.tells for p in table]]))


def _agrees(fit: Fit, block: Block) -> bool:
    """Whether two halves of the data find the same sign: profiles are compared by their evidence alone.

    How much the size scatters is for the stated error to say: what else is missing moves it from stretch to stretch.
    """
    laps = fit.normal.squares.shape[1]
    if block.effect.profile or laps < LEAST_STRETCHES:
        return True
    halves = np.array_split(np.arange(laps), 2)
    (first, its), (second, others) = fit.normal.estimates_of_parts(fit.normal.variance, halves)
    rows = block.parameters
    off = fit.parameters[rows] - np.array([p.prior for p in _table(fit, block)])
    same_sign = (off + first[rows]) * (off + second[rows]) > 0
    error = np.sqrt(np.maximum(np.diag(its + others)[rows], 0.0))
    return bool(np.any(same_sign | (np.abs(first - second)[rows] <= CONTRADICTED * error)))


def _confirmed(fit: Fit, block: Block) -> bool:
    """Whether what else tells a quantity of the effect agrees with it."""
    rows = range(block.parameters.start, block.parameters.stop)
    quantities = [p.quantity for p in block.effect.parameters]
    checks = [(EVIDENCE[q], row) for q, row in zip(quantities, rows, strict=False) if q in EVIDENCE]
    return all(check(fit, block, row) for check, row in checks)


def _by_kinematics(fit: Fit, block: Block, row: int) -> bool:
    """Whether the place of the accelerometer also shows where no tyre is in the equation, if sensors tell.

    What steering or tyres lack turns with the car as well, and would be taken for a sensor away from its centre. An ay
    sampled later than the yaw rate by half a step looks displaced by what the car travels in that time. Where no
    kinematics tell, it must be more than the car travels in a whole step.
    """
    ahead, record = float(fit.parameters[row]), fit.predictor.record
    travelled = record.step * float(record.signals["vx"][record.rows].mean())
    seen = accelerometer_ahead(record)
    if seen is None:
        return bool(np.max(np.abs(fit.parameters[block.parameters])) > travelled)
    return abs(seen[0] - ahead) < max(LEAST_ERRORS * seen[1] + 0.5 * travelled, CONFIRMED_SHARE * abs(ahead))


def _by_positions(fit: Fit, block: Block, row: int) -> bool:
    """Whether positions show at least half of a scale of speed, where the log has them."""
    scale, seen = float(fit.parameters[row]), speed_scale(fit.predictor.record)
    if seen is None:
        return True
    return abs(seen[0] - scale) < max(LEAST_ERRORS * seen[1], CONFIRMED_SHARE * abs(scale - 1.0), CLOCK)


def _by_heading(fit: Fit, block: Block, row: int) -> bool:
    """Whether the heading shows at least half of the gain of a gyroscope."""
    gain, seen = float(fit.parameters[row]), gyro_gain(fit.predictor.record)
    return seen is not None and abs(seen[0] - gain) < max(LEAST_ERRORS * seen[1], CONFIRMED_SHARE * abs(gain - 1.0))


def _by_course(fit: Fit, block: Block, row: int) -> bool:
    """Whether the course turns less than the yaw rate says by the zero of the gyroscope, where positions tell.

    Times the speed, that zero is an acceleration across the car: with one of the accelerometer against it, it looks
    like a bank of the whole lap.
    """
    seen = gyroscope_zero(fit.predictor.record)
    if seen is None:
        return True
    zero, rate = float(fit.parameters[row]), fit.predictor.record.measured[YAW_RATE]
    error = np.sqrt(max(float(fit.covariance[row, row]), float(fit.slow_variance[row])) + seen[1] ** 2)
    return bool(abs(seen[0] - zero) < max(LEAST_ERRORS * error, CLOCK * float(np.mean(np.abs(rate)))))


def _a_road(fit: Fit, block: Block, slope: Quantity) -> bool:
    """Whether a bank or grade is more than what repeats on a flat course.

    With few laps a force passes for a slope, and with many the springs do. A bank also lightens the axles, as less grip
    does, and a grade slows the car, as a brake does: where neither tyre nor drive is in the equation, sensors that tell
    must show at least half of it. So must d/dt vx of a grade that no sensor of ax shows, whatever forces follow speed
    and pedals.
    """
    record, coefficients = fit.predictor.record, fit.parameters[block.parameters]
    known = block.effect.name in record.road
    seen = None if known else share_in_kinematics(record, slope, coefficients)
    if seen is not None and seen < CONFIRMED_SHARE:
        return False
    return float(np.ptp(_over_the_lap(fit, block))) > 2.0 * LEAST_ANGLE


def _a_bank(fit: Fit, block: Block, row: int) -> bool:
    """Whether it is a road's."""
    return _a_road(fit, block, Quantity.BANK)


def _a_grade(fit: Fit, block: Block, row: int) -> bool:
    """Whether it is a road's that ends the lap at the height where it began."""
    grade = _over_the_lap(fit, block)
    level = abs(float(grade.mean())) < min(LEVEL, CLOSED_SHARE * float(np.ptp(grade)))
    return level and _a_road(fit, block, Quantity.GRADE)


def _over_the_lap(fit: Fit, block: Block) -> Array:
    """A profile at equal steps over the lap, four a knot."""
    basis = fit.predictor.record.bases[block.effect.profile]
    at = np.linspace(0.0, basis.period, 4 * basis.size, endpoint=False)
    return np.asarray(basis.matrix(at) @ fit.parameters[block.parameters])


def _as_high_as_a_car(fit: Fit, block: Block, row: int) -> bool:
    """Whether load transfer has the height of a car: with another one it stands in for brakes or tyres."""
    return LOWEST < float(fit.parameters[row]) / fit.predictor.record.vehicle.wheelbase < HIGHEST


EVIDENCE: Mapping[Quantity | None, Callable[[Fit, Block, int], bool]] = {
    Quantity.ACCELEROMETER_AHEAD: _by_kinematics,
    Quantity.SPEED_SCALE: _by_positions,
    Quantity.GYROSCOPE_GAIN: _by_heading,
    Quantity.GYROSCOPE_ZERO: _by_course,
    Quantity.BANK: _a_bank,
    Quantity.GRADE: _a_grade,
    Quantity.CG_HEIGHT: _as_high_as_a_car,
}
"""What else tells a quantity: whether it agrees with the parameter in a row of a fit."""


def _table(fit: Fit, block: Block) -> tuple[Parameter, ...]:
    return fit.predictor.table[block.parameters]
