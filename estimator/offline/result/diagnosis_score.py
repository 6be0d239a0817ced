"""Errors before and after, on laps no fit or choice has seen: per channel, and in open-loop prediction.

Specific forces are compared sample by sample. Yaw acceleration and d/dt vx, d/dt vy do not exist as sensors:
the measured signal is differentiated by a smoothing kernel, and the prediction passes through the same
kernel's smoothing, so that the filter cancels in the difference.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from estimator.drive_log.smoothing import second_difference_noise
from estimator.model.single_track import CHANNELS, SingleTrack
from estimator.offline.predict.expressions import STATES
from estimator.offline.predict.predict import Predictor
from estimator.offline.record.derivative import kernel, stretches
from estimator.offline.record.record import STATE_ROWS, Record
from hil_gateway.process.arrays import Array, Ints

HORIZON_S, LONG_HORIZON_S = 1.0, 3.0
"""of open-loop prediction: what the next decision rests on, and a whole bend"""
ROLLOUT_STATES = ("vx", "vy", "yaw_rate")
VX_DOT = CHANNELS.index("vx_dot")


def rmse(record: Record, rows: Ints, model: SingleTrack, parameters: Array) -> dict[str, float]:
    """RMS residual of every channel over the given rows."""
    residuals = channel_residuals(record, rows, model, parameters)
    return {name: float(np.sqrt(np.mean(r**2))) for name, (_, r) in residuals.items()}


def channel_residuals(
    record: Record, rows: Ints, model: SingleTrack, parameters: Array
) -> dict[str, tuple[Ints, Array]]:
    """Channel -> rows and measured less predicted, at the log's rate."""
    smooth, slope = kernel(record.step, record.kernel_s)
    half = len(smooth) // 2
    parts: dict[str, list[tuple[Ints, Array]]] = {name: [] for name in CHANNELS}
    for run in stretches(rows, record.step, record.kernel_s):
        whole = replace(record, rows=run[None, :, None], lap=np.zeros(1, np.int64))
        predicted = _as_derived(record, run, Predictor(model, whole).predict(parameters)[:, 0])
        for c, name in enumerate(CHANNELS):
            if c in STATE_ROWS:
                measured = np.convolve(record.measured[c, run], slope, "valid")
                parts[name].append((run[half:-half], measured - np.convolve(predicted[c], smooth, "valid")))
            else:
                parts[name].append((run, record.measured[c, run] - predicted[c]))
    return {
        name: (np.concatenate([r for r, _ in runs]), np.concatenate([v for _, v in runs]))
        for name, runs in parts.items()
    }


def _as_derived(record: Record, rows: Ints, predicted: Array) -> Array:
    """Predictions (5, n) with those of ax and ay as a log has them that derives them from velocities.

    What is derived has gravity in it, which no accelerometer feels.
    """
    vx, vy, rate = (record.signals[name][rows] for name in ("vx", "vy", "yaw_rate"))
    kinematic = {0: predicted[3] - vy * rate, 1: predicted[4] + vx * rate}
    return np.stack([kinematic[c] if c in kinematic and not record.used[c] else row for c, row in enumerate(predicted)])


def noise_floor(record: Record, rows: Ints, model: SingleTrack, parameters: Array) -> dict[str, float]:
    """What noise alone leaves in every channel: the sensor's own, and that of the states the model is evaluated at.

    The sensor's noise is measured on second differences: of the force residuals, of the motion signals. d/dt vx follows
    the pedals between the rows as well.
    """
    _, slope = kernel(record.step, record.kernel_s)
    gain = float(np.sqrt(np.sum(slope**2)))
    through_states = _noise_through_states(record, model, parameters)
    residuals = channel_residuals(record, rows, model, parameters)
    floor = {}
    for c, name in enumerate(CHANNELS):
        if c in STATE_ROWS:
            own = gain * second_difference_noise(record.measured[c, rows])
        else:
            own = second_difference_noise(residuals[name][1])
        floor[name] = float(np.hypot(own, through_states[c]))
    floor[CHANNELS[VX_DOT]] = float(np.hypot(floor[CHANNELS[VX_DOT]], _between_rows(record, rows, model, parameters)))
    return floor


def _between_rows(record: Record, rows: Ints, model: SingleTrack, parameters: Array) -> float:
    """RMS of the error of d/dt vx by what the drive command does between the rows, m/s2.

    A pedal that moves up and down faster than the log is known as badly there as it jumps from row to row.
    """
    smooth, _ = kernel(record.step, record.kernel_s)
    runs = stretches(rows, record.step, record.kernel_s)
    jumps = np.concatenate([np.diff(record.signals["drive"][run], 2) for run in runs]) if runs else np.zeros(1)
    stiffness = parameters[[p.name for p in model.tyre_table].index("cx")]
    return float(stiffness / model.vehicle.mass * np.sqrt(np.mean(jumps**2) / 6.0 * np.sum(smooth**2)))


def _noise_through_states(record: Record, model: SingleTrack, parameters: Array) -> Array:
    """(5,) RMS of the error in the predictions that the error of the smoothed states causes."""
    _, by_states = Predictor(model, record).linearise_motion(parameters)
    squares = np.mean(by_states**2, axis=(2, 3)) @ record.state_error**2
    return np.asarray(np.sqrt(squares))


def rollout(
    record: Record, rows: Ints, model: SingleTrack, parameters: Array, horizon_s: float = HORIZON_S
) -> dict[str, float]:
    """RMS error of vx, vy, yaw rate after `horizon_s` of simulation (Heun) from the smoothed state."""
    length = round(horizon_s / record.step)
    starts = [np.arange(run[0], run[-1] - length, length) for run in stretches(rows, record.step, record.kernel_s)]
    first = np.concatenate(starts) if starts else np.zeros(0, np.int64)
    if not len(first):
        return dict.fromkeys(ROLLOUT_STATES, 0.0)
    grid = first[:, None] + np.arange(length + 1)
    windows = replace(record, rows=grid[:, :, None], lap=np.zeros(len(grid), np.int64))
    end = _simulate(Predictor(model, windows), parameters, record.step)
    error = np.stack([record.signals[n][grid[:, -1]] for n in ROLLOUT_STATES]) - end
    error = error[:, np.all(np.isfinite(error), axis=0)]
    return {n: float(np.sqrt(np.mean(e**2))) for n, e in zip(ROLLOUT_STATES, error, strict=True)}


def _simulate(predictor: Predictor, parameters: Array, step: float) -> Array:
    """(3, windows) state at the end of every window."""
    inputs = predictor.inputs(parameters).reshape(-1, *predictor.record.rows.shape[:2])
    state = inputs[:STATES, :, 0].copy()

    def derivative(state: Array, k: int) -> Array:
        at = inputs[:, :, k].copy()
        at[:STATES] = state
        return predictor.at_inputs(at, parameters)[[3, 4, 2]]

    for k in range(inputs.shape[2] - 1):
        first = derivative(state, k)
        second = derivative(state + step * first, k + 1)
        state = state + 0.5 * step * (first + second)
    return state
