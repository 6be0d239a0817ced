"""Errors before and after, at smoothed states and along simulations: of held-out data, and of other logs."""

from __future__ import annotations

from dataclasses import dataclass

from estimator.drive_log.table import DriveLog
from estimator.model.columns import ModelColumns
from estimator.offline.fit.equation_error import rmse
from estimator.offline.predict.rollout import Rollout, roll_out
from estimator.offline.predict.simulate import OUTPUTS
from estimator.offline.record.prepare import Samples
from hil_gateway.process.arrays import Array

Scores = dict[str, tuple[float, float]]
"""channel -> root mean square of measured minus predicted, with the initial and the final parameters"""

ALGEBRAIC_CHANNELS = ("ax", "ay", "yaw_acc")


def simulations(
    columns: ModelColumns, theta: Array, log: DriveLog, samples: Samples, window_s: float
) -> tuple[Rollout, Rollout]:
    """Open-loop predictions of `samples` with the initial parameters and with `theta` (p,)."""
    before, after = (roll_out(columns, log, samples, one, window_s) for one in (columns.start, theta))
    return before, after


def score_samples(
    columns: ModelColumns, theta: Array, samples: Samples, rollouts: tuple[Rollout, Rollout] | None
) -> Scores:
    """Scores along `rollouts` for what a simulation predicts, at the smoothed states for the rest, or where none is."""
    scores = score_at_states(columns, theta, samples)
    if rollouts is not None:
        first, second = (r.rmse for r in rollouts)
        scores |= {c: (first[c], second[c]) for c in OUTPUTS}
    return scores


def score_at_states(columns: ModelColumns, theta: Array, samples: Samples) -> Scores:
    """Scores at the smoothed states as measured: what the forces are off by, wherever a simulation would drift."""
    before, after = (rmse(columns, samples, one, ALGEBRAIC_CHANNELS) for one in (columns.start, theta))
    return {c: (before[c], after[c]) for c in ALGEBRAIC_CHANNELS}


@dataclass(frozen=True)
class LogScore:
    """What a result makes of another log: scores, and those at its measured states."""

    rmse: Scores
    at_states: Scores


def as_summary(scores: Scores) -> dict[str, dict[str, float]]:
    """Scores as they appear in JSON."""
    return {channel: {"initial": initial, "final": final} for channel, (initial, final) in scores.items()}
