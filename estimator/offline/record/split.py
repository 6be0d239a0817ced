"""What is fitted and what is only scored: whole laps where there are laps, else blocks, with guard gaps between."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.drive_log.table import DriveLog
from estimator.offline.record.prepare import Samples
from hil_gateway.process.errors import InputError

MIN_LAPS = 4
EVERY = 4
BLOCK_S = 20.0
GUARD_S = 1.0
LEAST_S = 10.0
"""driving left to fit, at least"""


@dataclass(frozen=True)
class Split:
    """Masks over samples: `train` and `test` (n,), never within the guard time of each other; `kind` says how."""

    train: NDArray[np.bool_]
    test: NDArray[np.bool_]
    kind: str


def split(log: DriveLog, samples: Samples, every: int = EVERY, block_s: float = BLOCK_S) -> Split:
    """Hold out one lap (or block) of every `every`, not the last one, which is often the fastest or broken off.

    Raises:
        InputError: too little driving.
    """
    if samples.t.size * samples.step < 2 * LEAST_S:
        seconds = samples.t.size * samples.step
        raise InputError(f"only {seconds:.0f} s of driving in the log: at least {2 * LEAST_S:.0f} s are needed")
    laps = np.unique(log["lap"]) if "lap" in log else np.empty(0)
    if laps.size >= MIN_LAPS:
        number = np.searchsorted(laps, log["lap"])[samples.row]
        held = number % every == (2 if laps.size > 2 + 1 else 1)
        kind = f"{len(np.unique(number[held]))} of {laps.size} whole laps held out"
    else:
        block_s = min(block_s, samples.t.size * samples.step / every)
        number = np.floor(samples.t / block_s).astype(np.int64)
        held = number % every == every - 1
        kind = f"blocks of {block_s:g} s, one of every {every} held out"
    guard = round(GUARD_S / samples.step)
    near = np.convolve(held.astype(float), np.ones(2 * guard + 1), "same") > 0.5
    if (left := np.count_nonzero(~near) * samples.step) < LEAST_S:
        raise InputError(
            f"only {left:.0f} s are left to fit with {kind}: at least {LEAST_S:.0f} s are needed;"
            " give column lap the number of the lap, or remove it"
        )
    return Split(train=~near, test=held, kind=f"{kind}, {GUARD_S:g} s between")
