"""Load limits within a run, and what a run leaves behind for the next."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil_gateway.process.errors import InputError
from planner.problem.load_limits import SLEW, HeldLoad, LoadLimits, judged_limits, load_limits, store_limits

positive = st.floats(0.2, 3.0)
pairs = st.tuples(positive, positive)


def test_a_short_spike_is_not_a_demonstrated_load() -> None:
    held = HeldLoad(0.05)
    for load in (0.5, 0.6, 1.4, 0.6, 0.6, 0.6, 0.6):
        held.push(load)
    assert held.value == 0.6


def test_limits_survive_from_run_to_run(tmp_path: Path) -> None:
    path = tmp_path / "limits.json"
    assert load_limits(path) is None
    store_limits(path, LoadLimits(1.1, 1.2))
    assert load_limits(path) == LoadLimits(1.1, 1.2)


@pytest.mark.parametrize("content", ["", "{}", '{"front": 1.0, "rear": "x"}', '{"front": 9.0, "rear": 1.0}', "[1, 2]"])
def test_a_damaged_file_is_named(tmp_path: Path, content: str) -> None:
    path = tmp_path / "limits.json"
    path.write_text(content)
    with pytest.raises(InputError, match=r"limits\.json"):
        load_limits(path)


@given(st.floats(0.1, 1.0), pairs, pairs)
def test_loads_are_judged_by_limits_that_fall_no_faster_than_parameters_may(
    use: float, peaks: tuple[float, float], before: tuple[float, float]
) -> None:
    judged = judged_limits(use, np.array(peaks), before)
    for now, peak, last in zip(judged, peaks, before, strict=True):
        assert now == max(use * peak, (1.0 - SLEW) * last)


def test_less_grip_is_judged_by_within_seconds() -> None:
    judged, plans = (1.2, 1.2), 0
    while judged != (0.9, 0.9):
        judged, plans = judged_limits(0.9, np.array([1.0, 1.0]), judged), plans + 1
    assert plans == np.ceil(np.log(0.9 / 1.2) / np.log(1.0 - SLEW))
