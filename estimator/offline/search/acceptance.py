"""What a trial must show to be accepted, and an accepted effect to stay; and whether anything is left to explain.

A residual that is white in time has no structure that a model could take out.
"""

from __future__ import annotations

import numpy as np

from estimator.model.declared_vehicle import DECLARED, all_candidates
from estimator.model.single_track import CHANNELS
from estimator.offline.fit.normal import TINY
from estimator.offline.fit.prediction_error import Fit, residual
from estimator.offline.predict.predict import Predictor
from estimator.offline.record.noise import ResidualNoise
from estimator.offline.record.record import LATERAL_ROWS
from estimator.offline.record.road import SLOW_BLOCKS
from estimator.offline.search.evidence import Evidence
from estimator.offline.search.plausible import believed
from estimator.offline.search.trial import Setting, Trial
from hil_gateway.process.arrays import Array

SMALLEST_SHARE = 0.02
"""Least gain per block: a signal of about a fifth of the block noise in one channel. Less is not named."""
RELATIVE_SHARE = 0.01
"""Least gain relative to everything accepted so far: less is the imperfect shape of an accepted effect."""
BEYOND_NOISE = 1.25
"""RMS over the noise floor: 56 % more variance than noise; the true model stays within 3 % on practice drives."""
ACCELEROMETER = {
    CHANNELS.index(shown): CHANNELS.index(axis)
    for shown, axis in (("ax", "ax"), ("ay", "ay"), ("vx_dot", "ax"), ("vy_dot", "ay"))
}
"""Row of ax or ay for what shows in it or in the velocity along it."""
YAW_ACC, AY = CHANNELS.index("yaw_acc"), CHANNELS.index("ay")
"""Rows of `CHANNELS`; what turns the car by the forces of its tyres shows in ay too."""
NOT_WHITE = 1.3
"""Declared data compete where averages of what they leave vary no more than so many times what white noise would."""


def can_be_accepted(trial: Trial, setting: Setting, total: float) -> bool:
    """Whether a fit to the end earns its name."""
    return eligible(trial) and earns_its_place(trial.evidence, setting, total)


def eligible(trial: Trial) -> bool:
    """Whether the fit is believed; a declared datum must leave nothing else of the lateral motion to explain.

    A larger inertia, say, shrinks whatever error the predicted moment has. A force along the car, which a pedal that
    chatters between the rows of the log leaves in vx, is no error of the moment.
    """
    if trial.fit is None or not believed(trial.fit, trial.name):
        return False
    return trial.name not in DECLARED or not laterally_structured(trial.fit, NOT_WHITE)


def earns_its_place(evidence: Evidence, setting: Setting, total: float) -> bool:
    """Worth a name, consistent over laps, and not the imperfect shape of what is already there."""
    return worth_a_name(evidence, setting, total) and evidence.consistent


def stays(evidence: Evidence, setting: Setting) -> bool:
    """Whether what was accepted before still earns its name beside the others."""
    return worth_a_name(evidence, setting, 0.0) and evidence.still_consistent


def worth_a_name(evidence: Evidence, setting: Setting, total: float) -> bool:
    """Whether the gain is large enough, whatever its scatter."""
    blocks, most = setting.record.rows.shape[0] * setting.record.rows.shape[1], evidence.channel
    enough = evidence.gain > max(SMALLEST_SHARE * blocks, RELATIVE_SHARE * total)
    return bool(enough and evidence.channels[most] > setting.least[most])


def explains_more_than_is_left(effect: str, channel: int, without: Fit, final: Fit) -> bool:
    """Whether an effect that gains most in `channel` takes out more variance of the sensors that show it than `final`
    leaves there beyond noise.

    Where most has another cause, what gains may stand in for part of that: a force that comes and goes has a mean,
    which any force of the catalogue with the same sign takes out, and a wrong law of the tyres is partly made up for by
    another steering ratio. vx and vy do not tell: a filter follows them.
    """
    taken_out, left = without.normal.variance - final.normal.variance, _left_beyond_noise(final)
    shown = [row for row in _shown_by(effect, channel) if final.predictor.record.used[row]]
    return bool(np.all(taken_out[shown] > left[shown]))


def _shown_by(effect: str, channel: int) -> tuple[int, ...]:
    """Rows of the sensors of force or turning that show what gains most in `channel`."""
    if channel != YAW_ACC:
        return (ACCELEROMETER[channel],)
    return (YAW_ACC, AY) if "ay" in all_candidates()[effect].channels else (YAW_ACC,)


def leaves_more_than_noise(fit: Fit) -> bool:
    """Whether either accelerometer or the gyroscope shows more than the model and noise explain."""
    return bool(_left_beyond_noise(fit)[[*ACCELEROMETER.values(), YAW_ACC]].max() > 0.0)


def _left_beyond_noise(fit: Fit) -> Array:
    """(5,) variance of the residuals that is more than noise; negative where there is none."""
    return fit.normal.variance - (BEYOND_NOISE * fit.predictor.record.block_noise) ** 2


def slow_ratio(predictor: Predictor, parameters: Array, deviation: Array) -> Array:
    """(5,) variance of averages of the residual over 0.2 s, relative to what it would be for white noise."""
    error = residual(predictor, parameters, ResidualNoise.white(deviation))
    blocks = error.shape[2] // SLOW_BLOCKS * SLOW_BLOCKS
    averages = error[:, :, :blocks].reshape(*error.shape[:2], -1, SLOW_BLOCKS).mean(axis=3)
    ratio: Array = SLOW_BLOCKS * np.mean(averages**2, axis=(1, 2)) / np.maximum(np.mean(error**2, axis=(1, 2)), TINY)
    return ratio


def structured(fit: Fit, limit: float) -> bool:
    """Whether the residual of any channel varies slowly by more than `limit` times white noise."""
    return bool(np.any(slow_ratio(fit.predictor, fit.parameters, fit.deviation) > limit))


def laterally_structured(fit: Fit, limit: float) -> bool:
    """The same of the lateral channels and the yaw rate alone."""
    return bool(np.any(slow_ratio(fit.predictor, fit.parameters, fit.deviation)[LATERAL_ROWS] > limit))
