"""Windows of a log for simulation: lanes of equal length side by side, padded where the data ends."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.drive_log.table import DriveLog
from estimator.model.single_track import SIGNALS
from estimator.offline.record.prepare import Samples
from hil_gateway.process.arrays import Array
from hil_gateway.process.errors import InputError

MIN_WINDOW_SHARE = 0.25
"""A shorter rest of a stretch is joined to nothing and left out."""


@dataclass(frozen=True)
class Windows:
    """L windows of K samples.

    Attributes:
        inputs: (k, K, L) model inputs, rows as `Samples.inputs`.
        measured: (4, K, L) vy, yaw rate, ay as measured, and the yaw acceleration from the yaw rate.
        weight: (K, L) 1 for a sample, 0 for padding.
        index: (K, L) sample each entry comes from (padding repeats the last).
        step: s between samples.
    """

    inputs: Array
    measured: Array
    weight: Array
    index: NDArray[np.int64]
    step: float

    @property
    def count(self) -> int:
        """Number of windows."""
        return int(self.weight.shape[1])


def cut(log: DriveLog, samples: Samples, length_s: float) -> Windows:
    """Windows of `length_s` from every uninterrupted stretch of `samples` (not thinned).

    Raises:
        InputError: no stretch is long enough for one.
    """
    size = max(8, round(length_s / samples.step) + 1)
    index, weight = _lanes(samples, size)
    if not index.size:
        least_s = max(8, MIN_WINDOW_SHARE * size) * samples.step
        raise InputError(
            f"the log has no uninterrupted {least_s:.2g} s to simulate among what is fitted, or what is held out:"
            " drive longer without spinning, or give a shorter --window"
        )
    row = samples.row[index]
    return Windows(
        inputs=samples.inputs[:, index],
        measured=np.stack([*(log[name][row] for name in ("vy", "yaw_rate", "ay")), samples["yaw_acc"][index]]),
        weight=weight,
        index=index,
        step=samples.step,
    )


def _lanes(samples: Samples, size: int) -> tuple[NDArray[np.int64], Array]:
    """(size, L) sample index and weight of each window."""
    broken = (np.diff(samples.row) > 1) | (np.diff(samples.segment) != 0)
    edges = np.concatenate([[0], np.flatnonzero(broken) + 1, [len(samples)]])
    starts, stops = [], []
    for first, last in itertools.pairwise(edges):
        for start in range(int(first), int(last), size):
            stop = min(start + size, int(last))
            if stop - start >= max(8, MIN_WINDOW_SHARE * size):
                starts.append(start)
                stops.append(stop)
    offset = np.arange(size)[:, None]
    index = np.array(starts, dtype=np.int64)[None, :] + offset
    last_index = np.array(stops, dtype=np.int64)[None, :] - 1
    return np.minimum(index, last_index), (index <= last_index).astype(float)


STATE_ROWS = (SIGNALS.index("vy"), SIGNALS.index("yaw_rate"))
"""Rows of the inputs that a simulation replaces by its own states."""
