"""Load limits of Eq. (10) within a run, and what one run leaves behind for the next.

One principle: with the probability of `planner.sigma_level` standard deviations of the belief no axle uses more than
the share `planner.load_use` of what its tyres can give. The load rows hold it for every plan, at the slips of the plan;
the speed profile for every bend ahead, in force (`planner.adoption.usable_grip`). Limits widen as the belief tightens
and with the loads a car has held, and fall as soon as the belief does.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from hil_gateway.config import PlannerConfig
from hil_gateway.process.arrays import Array
from hil_gateway.process.errors import InputError
from hil_gateway.process.figures import figure
from hil_gateway.process.writable import check_file
from hil_gateway.text_file import read_json

HOLD_S = 0.2
"""a load held for so long is one the tyre bears, and not the tip of a swing"""
SLEW = 0.01
"""largest relative change of a tyre parameter, and decrease of a limit, from one plan to the next"""


@dataclass(frozen=True)
class LoadLimits:
    """Forces over axle load, front and rear."""

    front: float
    rear: float

    @property
    def pair(self) -> tuple[float, float]:
        """(front, rear)"""
        return self.front, self.rear


def judged_limits(use: float, peaks_in_force: Array, before: tuple[float, float] | None) -> tuple[float, float]:
    """F-bar over axle load (front, rear) that loads are judged by, from the peak factors D (2,) in force.

    They come down from those `before` by `SLEW` a plan at most, as fast as parameters in force may change: forces by
    the tyres of the plan under way, set against limits of other tyres, say nothing of the car.
    """
    supported = use * peaks_in_force
    judged = supported if before is None else np.maximum(supported, (1.0 - SLEW) * np.array(before))
    return float(judged[0]), float(judged[1])


class SustainedLoad:
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
        if not Path(path).exists():
            return None
        data = read_json(path, "load limits")
    except InputError as error:
        raise InputError(f"{error}; delete the file to start from the prior") from None
    try:
        limits = LoadLimits(float(data["front"]), float(data["rear"]))
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path}: not a file of load limits ({error}); delete it to start from the prior") from None
    if not (0 <= limits.front < 5 and 0 <= limits.rear < 5):
        raise InputError(f"{path}: load limits {figure(limits.pair)} are not within 0..5 axle loads; delete the file")
    return limits


def starting_limits(planner: PlannerConfig) -> LoadLimits:
    """Loads that an earlier run has held, none where there was none.

    Raises:
        InputError: the file is not one of ours, or could not be written when the run ends.
    """
    if not planner.load_limits:
        return LoadLimits(0.0, 0.0)
    check_file(Path(planner.load_limits), option="planner.load_limits")
    return load_limits(planner.load_limits) or LoadLimits(0.0, 0.0)


def store_limits(path: str | Path, limits: LoadLimits) -> None:
    """Write limits for the next run; a reader sees the old file or the new one."""
    target = Path(path)
    temporary = target.with_suffix(".tmp")
    temporary.write_text(json.dumps(asdict(limits)))
    temporary.replace(target)
