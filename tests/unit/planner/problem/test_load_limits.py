"""Load limits: one share of the peaks in force, loads a car has held, and what survives from run to run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil_gateway.config import PlannerConfig
from hil_gateway.process.errors import InputError
from planner.problem.load_limits import (
    SLEW,
    LoadLimits,
    SustainedLoad,
    judged_limits,
    load_limits,
    starting_limits,
    store_limits,
)

PLANS_PER_S = 20.0
positive = st.floats(0.2, 3.0)
pairs = st.tuples(positive, positive)


@given(st.floats(0.1, 1.0), pairs, pairs)
def test_loads_are_judged_by_the_share_of_the_peaks_or_come_down_to_it(
    use: float, peaks: tuple[float, float], before: tuple[float, float]
) -> None:
    judged = judged_limits(use, np.array(peaks), before)
    for limit, peak, old in zip(judged, peaks, before, strict=True):
        assert limit >= use * peak
        assert limit == pytest.approx(use * peak) or limit == pytest.approx((1.0 - SLEW) * old)
        assert limit <= max(use * peak, old)
    assert judged_limits(use, np.array(peaks), None) == pytest.approx(use * np.array(peaks))


def test_lesser_peaks_are_judged_by_within_seconds() -> None:
    judged, plans = (1.26, 1.26), 0
    while judged != pytest.approx((1.26, 0.9), abs=1e-12):
        judged = judged_limits(0.9, np.array([1.4, 1.0]), judged)
        plans += 1
        assert judged[0] == pytest.approx(1.26), "the axle whose peak stays is not touched"
        assert judged[1] >= 0.9, "never below what the tyres of the plan bear"
    assert 1.0 < plans / PLANS_PER_S < 3.0


@given(st.lists(st.floats(0.0, 2.0), min_size=4, max_size=30))
def test_a_held_load_is_the_largest_that_lasted(loads: list[float]) -> None:
    held, seen = SustainedLoad(0.05), []
    for load in loads:
        held.push(load)
        seen.append(held.value)
    assert seen == sorted(seen)
    assert held.value == max(min(loads[i : i + 4]) for i in range(len(loads) - 3))


def test_a_short_spike_is_not_a_demonstrated_load() -> None:
    held = SustainedLoad(0.05)
    for load in (0.5, 0.6, 1.4, 0.6, 0.6, 0.6, 0.6):
        held.push(load)
    assert held.value == 0.6


def test_limits_survive_from_run_to_run(tmp_path: Path) -> None:
    path = tmp_path / "limits.json"
    assert load_limits(path) is None
    planner = PlannerConfig(load_limits=str(path))
    assert starting_limits(planner) == LoadLimits(0.0, 0.0), "a first run has held nothing"
    for limits in (LoadLimits(1.1, 1.2), LoadLimits(0.0, 0.0)):
        store_limits(path, limits)
        assert starting_limits(planner) == load_limits(path) == limits


DAMAGED = [
    "", "{}", '{"front": -0.1, "rear": 1.0}', '{"front": 1.0, "rear": "x"}', '{"front": 9.0, "rear": 1.0}', "[1, 2]",
]  # fmt: skip


@pytest.mark.parametrize("content", DAMAGED)
def test_a_damaged_file_is_named(tmp_path: Path, content: str) -> None:
    path = tmp_path / "limits.json"
    path.write_text(content)
    with pytest.raises(InputError, match=r"limits\.json"):
        load_limits(path)
