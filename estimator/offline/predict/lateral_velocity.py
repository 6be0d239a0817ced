"""vy where no sensor measures it: what a model predicts, corrected by the measured yaw rate and forward velocity.

A state filter without a side-slip sensor is off by about 0.1 m/s for seconds. At 30 m/s and 250 m/s2 of lateral force
per rad of slip that is 0.8 m/s2, several times the noise of an accelerometer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimator.model.single_track import SingleTrack
from estimator.offline.predict.innovations import VY_ROW
from estimator.offline.predict.linearised import linearised
from estimator.offline.predict.predict import Predictor
from estimator.offline.record.noise import ResidualNoise
from estimator.offline.record.record import STATE_ROWS, Record
from hil_gateway.process.arrays import Array, Ints

VY = STATE_ROWS.index(VY_ROW)


def with_predicted_vy(
    record: Record, stretches: Sequence[Ints], model: SingleTrack, parameters: Array, noise: ResidualNoise
) -> Record:
    """The record with vy as the model sees it; as it is where a sensor of its own measures vy.

    Args:
        record: the whole log.
        stretches: uninterrupted rows of it.
        model, parameters: what predicts.
        noise: how far it is trusted between the measurements.
    """
    if record.used[VY_ROW]:
        return record
    vy = record.signals["vy"].copy()
    for rows in stretches:
        vy[rows] += _correction(record, rows, model, parameters, noise)
    return replace(record, signals={**record.signals, "vy": vy})


def _correction(record: Record, rows: Ints, model: SingleTrack, parameters: Array, noise: ResidualNoise) -> Array:
    """(n,) what is added to vy over one stretch: between the edges of its blocks it is linear in time."""
    size = record.rows.shape[2]
    blocks = rows[: len(rows) // size * size].reshape(1, -1, size)
    one = replace(record, rows=blocks, lap=np.zeros(1, np.int64))
    at_edges = linearised(one, *Predictor(model, one).linearise_motion(parameters), noise).state_errors[:, 0, VY]
    return np.interp(rows, blocks[0, :, 0], at_edges)
