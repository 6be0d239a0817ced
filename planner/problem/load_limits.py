"""Load limits F-bar of Eq. (10) and how they widen from run to run (envelope expansion).

The rule, per axle, in units of axle load:

    supported = (1 - SAFETY) * (mean - CONFIDENCE * std) of the peak factor D at the end of a run
    held = largest load held for `HOLD_S` in the run
    next = max(supported, min(held, present, (1 - SAFETY) * mean))  if supported is below the present limit: shrink
    next = min(supported, held * (1 + STEP), present * (1 + STEP))  otherwise, never below the present limit

So the envelope grows only as far as the belief supports it, by at most STEP a run, and not beyond STEP over what
the car has been seen to hold; it shrinks at once, but not below that while the belief's mean agrees: a peak that was
never driven to stays uncertain. One standard deviation, because Eq. (10) holds at the sigma points besides.
Within a run the envelope only shrinks (`limits_within_run`).
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from hil_gateway.config import PlannerConfig
from hil_gateway.process.arrays import Array
from hil_gateway.process.errors import InputError
from hil_gateway.process.figures import figure
from hil_gateway.process.writable import check_file

SAFETY = 0.03
CONFIDENCE = 1.0
STEP = 0.1
HOLD_S = 0.2
SLEW = 0.01
"""largest relative change of a tyre parameter, and decrease of a limit, from one plan to the next"""
RESERVE_FADES = (0.15, 0.31)
"""spread of the belief over the prior's between which plans give up their reserve of load, the larger one first"""
RESERVE_LEFT = 0.12
DEVIATION = 0.17
"""relative difference of a parameter in force from the belief's mean at which plans keep the whole reserve"""


@dataclass(frozen=True)
class LoadLimits:
    """F-bar over axle load, front and rear."""

    front: float
    rear: float

    @property
    def pair(self) -> tuple[float, float]:
        """(front, rear)"""
        return self.front, self.rear

    def less(self, share: float) -> LoadLimits:
        """Smaller by `share`."""
        return LoadLimits((1.0 - share) * self.front, (1.0 - share) * self.rear)


@dataclass(frozen=True)
class RunEvidence:
    """What one run showed of one axle: belief about D at its end, largest load held over axle load."""

    peak_mean: float
    peak_std: float
    held: float


def next_limit(present: float, run: RunEvidence) -> float:
    """Limit of one axle for the next run."""
    supported = (1.0 - SAFETY) * (run.peak_mean - CONFIDENCE * run.peak_std)
    if supported < present:
        return max(supported, min(present, run.held, (1.0 - SAFETY) * run.peak_mean), 0.1)
    return max(present, min(supported, (1.0 + STEP) * run.held, (1.0 + STEP) * present))


def limits_within_run(
    of_run: LoadLimits, use: float, peaks_in_force: Array, peaks_believed: Array, before: LoadLimits | None
) -> tuple[LoadLimits, LoadLimits]:
    """(what the tyres may be asked to bear now, the limits their loads are judged by), from peak factors D (2,).

    Asked for is that of the run or the share `use` of the lesser D, of the one the motion is predicted with and of the
    mean of the belief: a belief that has learnt of less grip tells at once, before the model in force follows. Judged
    is by limits that come down by `SLEW` a plan from those `before`, as fast as the parameters in force may change:
    forces by the tyres of the plan under way, set against limits of other tyres, say nothing of the car. Neither is
    ever wider than that of the run.
    """
    supported = np.minimum(of_run.pair, use * np.minimum(peaks_in_force, peaks_believed))
    judged = supported if before is None else np.maximum(supported, (1.0 - SLEW) * np.array(before.pair))
    return LoadLimits(*supported.tolist()), LoadLimits(*judged.tolist())


def reserve(largest: float, spread: float, theta: Array, mean: Array) -> float:
    """Share of the load limits that plans leave alone.

    All of `largest` is for tyres that may bear less than believed. It is given up as the belief tightens (`spread` over
    that of the prior), if the parameters in force `theta` are those of its `mean`: who drives with others plans loads
    that are not the tyres'. `RESERVE_LEFT` of it stays, for noise.
    """
    low, high = RESERVE_FADES
    doubt = (spread - low) / (high - low)
    deviation = float(np.max(np.abs(theta / mean - 1.0))) / DEVIATION
    return largest * float(np.clip(max(doubt, deviation), RESERVE_LEFT, 1.0))


class HeldLoad:
    """Largest load held without a break for `HOLD_S`, from samples every `period` s."""

    def __init__(self, period: float) -> None:
        self._recent: list[float] = []
        self._length = max(1, round(HOLD_S / period))
        self.value = 0.0

    def push(self, load: float) -> None:
        """Add one sample of load over axle load."""
        self._recent = [*self._recent, load][-self._length :]
        if len(self._recent) == self._length:
            self.value = max(self.value, min(self._recent))


def load_limits(path: str | Path) -> LoadLimits | None:
    """Limits stored by an earlier run; None where there was none.

    Raises:
        InputError: a file that is not one of ours.
    """
    try:
        data = json.loads(Path(path).read_text())
        limits = LoadLimits(float(data["front"]), float(data["rear"]))
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path}: not a file of load limits ({error}); delete it to start from the prior") from None
    if not (0 < limits.front < 5 and 0 < limits.rear < 5):
        raise InputError(f"{path}: load limits {figure(limits.pair)} are not within 0..5 axle loads; delete the file")
    return limits


def starting_limits(planner: PlannerConfig, tyre: Mapping[str, float]) -> LoadLimits:
    """Load limits of this run: stored by the last one, else a share of the peak forces of the starting model.

    Raises:
        InputError: the file is not one of ours, or could not be written when the run ends.
    """
    if planner.load_limits:
        check_file(Path(planner.load_limits), option="planner.load_limits")
    stored = load_limits(planner.load_limits) if planner.load_limits else None
    if stored is not None:
        return stored
    use = planner.load_use
    return LoadLimits(use * tyre.get("df", tyre.get("d", 1.0)), use * tyre.get("dr", tyre.get("d", 1.0)))


def store_limits(path: str | Path, limits: LoadLimits) -> None:
    """Write limits for the next run; a reader sees the old file or the new one."""
    target = Path(path)
    temporary = target.with_suffix(".tmp")
    temporary.write_text(json.dumps(asdict(limits)))
    temporary.replace(target)
