"""What is fitted and what is only scored: whole laps where there are laps, else blocks, with guard gaps between."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.drive_log.table import DriveLog
from estimator.offline.record.prepare import Samples
from hil_gateway.process.errors import InputError

EVERY = 4
BLOCK, GUARD, LEAST = 36.3, 1.82, 18.2
"""A held-out block, the gap beside it, and the least driving left to fit, over the car's own time: 20 s, 1 s and 10 s
of an AV-24. A small car does in a second what a large one does in four; what the data determine, the fit says."""


@dataclass(frozen=True)
class Split:
    """Masks over samples: `train` and `test` (n,), never within the guard time of each other; `kind` says how."""

    train: NDArray[np.bool_]
    test: NDArray[np.bool_]
    kind: str


def split(log: DriveLog, samples: Samples, own_time: float, every: int = EVERY) -> Split:
    """Hold out one lap (or block) of every `every`, not the last one, which is often the fastest or broken off.

    `own_time` of the car, s.

    Raises:
        InputError: too little driving.
    """
    seconds, guard_s, least_s = samples.t.size * samples.step, GUARD * own_time, LEAST * own_time
    if seconds < 2 * least_s:
        raise InputError(f"only {seconds:.2g} s of driving in the log: a car of this size needs {2 * least_s:.2g} s")
    laps = np.unique(log["lap"]) if "lap" in log else np.empty(0)
    if laps.size >= EVERY:
        number = np.searchsorted(laps, log["lap"])[samples.row]
        held = number % every == (2 if laps.size > 2 + 1 else 1)
        kind = f"{len(np.unique(number[held]))} of {laps.size} whole laps held out"
    else:
        block_s = min(BLOCK * own_time, seconds / every)
        number = np.floor((samples.t - log["t"][0]) / block_s).astype(np.int64)
        held = number % every == every - 1
        kind = f"blocks of {block_s:.3g} s, one of every {every} held out"
    guard = round(guard_s / samples.step)
    near = np.convolve(held.astype(float), np.ones(2 * guard + 1), "same") > 0.5
    if (left := np.count_nonzero(~near) * samples.step) < least_s:
        raise InputError(
            f"only {left:.2g} s are left to fit with {kind}: a car of this size needs {least_s:.2g} s;"
            " give column lap the number of the lap, or remove it"
        )
    return Split(train=~near, test=held, kind=f"{kind}, {guard_s:.2g} s between")
