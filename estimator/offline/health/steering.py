"""Reported steering against the road wheels: their lag (servo, column, command path) and a zero that is off.

The lag is always fitted along with the tyres, a zero where it is seen to be off, so that what the car's own dynamics
do is not taken for them. The delay in the model is of first order: a lag of more than a sample is taken out of the log
and the rest estimated again.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from estimator.drive_log.table import DriveLog
from estimator.offline.fit.equation_error import EquationErrorFit
from estimator.offline.health.finding import Action, LogFinding, confidence_of
from estimator.offline.health.offsets import shifted
from estimator.offline.health.regression import PARTS, jackknifed
from estimator.offline.health.straight import goes_straight
from estimator.offline.predict.nuisance import STEER_TIMING, steer_zero
from estimator.offline.record.prepare import prepare
from hil_gateway.car.vehicle import Vehicle

LAG_STEER = "lag_steer"
OFFSET_STEER, UNKNOWN_ZERO = "offset_steer", "unknown_zero_steer"
LEAST_SAMPLES = 1.5
LEAST_S = 0.015
LONGEST_S = 0.2
LEAST_OFFSET = 0.002
"""rad; less changes no tyre parameter to speak of"""

GENTLE_SHARE = 0.5
"""Only samples below this share of the log's hardest cornering are used."""


def lag_of(fit: EquationErrorFit, step: float, again: bool = False) -> LogFinding | None:
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
    return LogFinding(LAG_STEER, "steer", _text(size), size, std, "s", confidence, Action.REALIGNED, repair, _text)


def without_lag(log: DriveLog, findings: Sequence[LogFinding]) -> DriveLog:
    """Another `log` of the same car, with the steering lag among `findings` taken out."""
    lag = sum(f.size for f in findings if f.name == LAG_STEER)
    return shifted(log, "steer", -lag) if lag else log


def find(log: DriveLog, vehicle: Vehicle) -> list[LogFinding]:
    """Steering that does not read zero with the wheels straight; the fit then estimates by how much.

    In gentle driving the angle is that of the path, plus understeer in proportion to ay and to the yaw acceleration,
    plus the lag; what is left when all of these are zero is the offset.
    """
    samples = prepare(log)
    yaw_rate, ay = samples["yaw_rate"], samples["vx"] * samples["yaw_rate"]
    path = yaw_rate / samples["vx"]
    if not goes_straight(path):
        return [_unknown()]
    gentle = np.abs(ay) < GENTLE_SHARE * np.quantile(np.abs(ay), 0.99)
    if gentle.sum() < 50 * PARTS:
        return []
    X = np.stack([np.ones_like(ay), path, ay, samples["yaw_acc"], samples["steer_rate"]], axis=1)[gentle]
    solution, spread = jackknifed(X, samples["steer"][gentle])
    return _zero(float(solution[0]), float(spread[0]))


def _unknown() -> LogFinding:
    text = (
        "whether the steering reads zero with the wheels straight cannot be told: the car turns one way all the time;"
        " drive a straight, or turn both ways"
    )
    return LogFinding(UNKNOWN_ZERO, "steer", text, float("nan"), float("nan"), "rad", 0.0)


def zero_of(fit: EquationErrorFit) -> LogFinding | None:
    """The steering zero as `fit` estimated it along with the tyres, None where it did not."""
    name = steer_zero().parameters[0].name
    found = _zero(-fit.values[name], fit.std[name]) if name in fit.values else []
    return found[0] if found else None


def _zero(size: float, std: float) -> list[LogFinding]:
    if abs(size) < max(LEAST_OFFSET, 3.0 * std):
        return []
    text = f"the reported steering reads {np.degrees(size):+.2f} +- {np.degrees(std):.2f} deg with the wheels straight"
    confidence = confidence_of(size, std, LEAST_OFFSET)
    return [LogFinding(OFFSET_STEER, "steer", text, size, std, "rad", confidence, Action.CORRECTED)]


def _text(size: float) -> str:
    return f"the road wheels lag the reported steering by {1000 * size:.0f} ms"
