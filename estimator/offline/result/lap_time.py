"""What the errors of a model cost as lap time: the quasi-steady lap along the path that was driven.

Bends are driven at the grip there, v^2 = a_y / curvature; from the slowest point of a bend to the fastest before the
next the car drives as it can, from there on it brakes: d(v^2 / 2)/ds = a_x. A model that is off by a share of a_y in a
bend and by some a_x between has another v^2 everywhere. The lap time follows to first order in it: the driven lap is
its own quasi-steady lap. Point mass as in Milliken and Milliken, Race Car Vehicle Dynamics, 1995.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

import numpy as np

from estimator.model.single_track import SingleTrack
from estimator.offline.record.record import Record
from estimator.offline.result.diagnosis_score import channel_residuals
from hil_gateway.process.arrays import Array, Ints

BEND = 0.5
"""Share of the hardest cornering of a lap from which on grip limits the speed, not power."""


def lap_times(record: Record, test_rows: Ints, models: Mapping[str, tuple[SingleTrack, Array]]) -> dict[str, float]:
    """Mean time of the whole scored laps, s: "driven", and by each model with its parameters; empty without one.

    A lap is whole where others are before and behind it.
    """
    scored, every = np.unique(record.lap_of_row[test_rows]), np.unique(record.lap_of_row)
    laps = [np.flatnonzero(record.lap_of_row == lap) for lap in scored if every[0] < lap < every[-1]]
    if not record.has_laps or not laps:
        return {}
    driven = float(np.mean([len(rows) * record.step for rows in laps]))
    times = {"driven": driven}
    for name, (model, parameters) in models.items():
        errors = channel_residuals(record, test_rows, model, parameters)
        times[name] = driven + float(np.mean([_change(record, rows, errors) for rows in laps]))
    return times


def _change(record: Record, rows: Ints, errors: Mapping[str, tuple[Ints, Array]]) -> float:
    """s, of the lap of these rows; where a model is not scored it has no error."""
    vx, rate = (record.signals[name][rows] for name in ("vx", "yaw_rate"))
    along, across = np.zeros((2, len(rows)))
    for values, channel in ((along, "vx_dot"), (across, "ay")):
        at, error = errors[channel]
        inside = np.isin(at, rows)
        values[at[inside] - rows[0]] = error[inside]
    return change_of_lap_time(vx, vx * rate, along, across, record.step)


def change_of_lap_time(speed: Array, cornering: Array, along: Array, across: Array, step: float) -> float:
    """Lap time by a model less that of the lap driven, s, to first order in the errors of the model.

    Args:
        speed, cornering: (n,) of one lap in rows of `step` s: m/s, m/s2.
        along, across: (n,) driven less predicted acceleration along and across the car, m/s2.
    """
    hard = np.abs(cornering) > BEND * np.abs(cornering).max()
    if not hard.any():
        return 0.0
    start = int(np.argmin(np.where(hard, speed, np.inf)))
    speed, cornering, along, across, hard = (np.roll(v, -start) for v in (speed, cornering, along, across, hard))
    work = np.cumsum(along * speed * step)
    bends = np.split(np.flatnonzero(hard), np.flatnonzero(np.diff(np.flatnonzero(hard)) > 1) + 1)
    slowest = [int(bend[np.argmin(speed[bend])]) for bend in bends]
    lost = [
        0.5 * speed[at] ** 2 * _share(across[bend], cornering[bend]) for at, bend in zip(slowest, bends, strict=True)
    ]
    energy = np.zeros(len(speed))
    for (a, b), (at_a, at_b) in zip(pairwise([*slowest, len(speed)]), pairwise([*lost, lost[0]]), strict=True):
        fastest = a + int(np.argmax(speed[a:b]))
        energy[a:fastest] = -at_a - (work[a:fastest] - work[a])
        energy[fastest:b] = -at_b + (work[b - 1] - work[fastest:b])
    return float(-np.sum(energy / speed**2) * step)


def _share(across: Array, cornering: Array) -> float:
    """Least-squares share of the cornering of a bend that a model lacks."""
    return float(across @ cornering / (cornering @ cornering))
