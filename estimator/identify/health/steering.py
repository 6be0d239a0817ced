"""Lag of the road wheels behind the reported steering: servo, column and command path.

The lag is fitted along with the tyres, so that what the car's own dynamics delay is not taken for it. The delay in
the model is of first order: a lag of more than a sample is taken out of the log and the rest estimated again.
"""

from __future__ import annotations

from estimator.identify.drive_log import DriveLog
from estimator.identify.fit import Fit
from estimator.identify.health.finding import Action, Finding, confidence_of
from estimator.identify.health.offsets import shifted
from estimator.identify.nuisance import STEER_TIMING

LAG_STEER = "lag_steer"
LEAST_SAMPLES = 1.5
LEAST_S = 0.015
LONGEST_S = 0.2


def lag_of(fit: Fit, step: float, again: bool = False) -> Finding | None:
    """Finding for the steering lag that `fit` estimated, None where there is none to speak of.

    Once a lag was taken out (`again`), half a sample of what is left is worth another round.
    """
    name = f"{STEER_TIMING}.tau"
    if name not in fit.values:
        return None
    size, std = fit.values[name], fit.std[name]
    least = 0.5 * step if again else max(LEAST_S, LEAST_SAMPLES * step)
    if not least < size < LONGEST_S or size < 4.0 * std:
        return None

    def repair(log: DriveLog) -> DriveLog:
        return shifted(log, "steer", -size)

    confidence = confidence_of(size, std, least)
    return Finding(LAG_STEER, "steer", _text(size), size, std, "s", confidence, Action.REALIGNED, repair, _text)


def _text(size: float) -> str:
    return f"the road wheels lag the reported steering by {1000 * size:.0f} ms"
