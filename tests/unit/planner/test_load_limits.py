"""Envelope expansion: load limits widen only as far as the belief and the run support, and shrink at once."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil_gateway.process.errors import InputError
from planner.problem.load_limits import (
    DEVIATION,
    RESERVE_FADES,
    RESERVE_LEFT,
    SLEW,
    HeldLoad,
    LoadLimits,
    RunEvidence,
    limits_within_run,
    load_limits,
    next_limit,
    reserve,
    store_limits,
)

positive = st.floats(0.2, 3.0)
limits = st.builds(LoadLimits, positive, positive)
peaks = st.tuples(positive, positive).map(np.array)


@given(positive, positive, st.floats(0.0, 1.0), positive)
def test_next_limit_never_exceeds_what_belief_run_and_step_support(
    present: float, mean: float, std: float, held: float
) -> None:
    new = next_limit(present, RunEvidence(mean, std, held))
    supported = 0.97 * (mean - std)
    assert new <= max(0.1, supported, min(present, held, 0.97 * mean)) + 1e-12
    assert new <= 1.1 * present + 1e-12
    assert new <= max(present, 1.1 * held) + 1e-12


@given(positive, positive, positive)
def test_limits_widen_monotonically_as_the_belief_tightens(present: float, mean: float, held: float) -> None:
    widened = [next_limit(present, RunEvidence(mean, std, held)) for std in (0.5, 0.2, 0.1, 0.05, 0.0)]
    assert all(b >= a - 1e-12 for a, b in pairwise(widened))


def test_limits_shrink_at_once_when_the_belief_does_not_support_them() -> None:
    assert next_limit(1.3, RunEvidence(1.0, 0.05, held=0.6)) == pytest.approx(0.97 * 0.95)
    assert next_limit(1.3, RunEvidence(1.0, 0.05, held=1.2)) == pytest.approx(0.97), "no further than the mean agrees"


def test_limits_do_not_shrink_below_what_the_car_has_held() -> None:
    assert next_limit(1.2, RunEvidence(1.3, 0.3, held=1.1)) == pytest.approx(1.1)


def test_envelope_reaches_the_supported_limit_over_several_runs() -> None:
    limit, history = 0.9, []
    for run in range(8):
        limit = next_limit(limit, RunEvidence(1.4, 0.3 / (run + 1), held=0.98 * limit))
        history.append(limit)
    assert history == sorted(history)
    assert 1.2 < limit <= 0.97 * 1.4


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


@given(limits, st.floats(0.1, 1.0), peaks, peaks, limits)
def test_within_a_run_limits_never_widen_and_follow_the_lesser_grip(
    of_run: LoadLimits, use: float, in_force: np.ndarray, believed: np.ndarray, before: LoadLimits
) -> None:
    asked, judged = limits_within_run(of_run, use, in_force, believed, before)
    for axle in (0, 1):
        assert asked.pair[axle] in (of_run.pair[axle], use * in_force[axle], use * believed[axle])
        assert asked.pair[axle] <= min(of_run.pair[axle], use * in_force[axle], use * believed[axle])
        assert judged.pair[axle] == max(asked.pair[axle], (1.0 - SLEW) * before.pair[axle])


def test_less_grip_is_asked_for_at_once_and_judged_by_within_seconds() -> None:
    start, believed = LoadLimits(1.2, 1.2), np.array([1.4, 1.0])
    judged, plans = start, 0
    while True:
        asked, judged = limits_within_run(start, 0.9, np.array([1.4, 1.4]), believed, judged)
        plans += 1
        assert asked.pair == (1.2, 0.9)
        if judged == asked:
            break
    assert plans == np.ceil(np.log(0.9 / 1.2) / np.log(1.0 - SLEW))


def test_the_reserve_of_load_is_given_up_for_tyres_that_are_known_and_driven_with() -> None:
    theta = np.array([5e4, 9.0, 1.35])
    assert reserve(0.2, 1.0, theta, theta) == 0.2
    assert reserve(0.2, float(np.mean(RESERVE_FADES)), theta, theta) == pytest.approx(0.1)
    assert reserve(0.2, 0.1, theta, theta) == 0.2 * RESERVE_LEFT
    assert reserve(0.2, 0.1, theta, theta / [1.0, 1.0 + DEVIATION, 1.0]) == pytest.approx(0.2), "another model in force"
    assert reserve(0.2, 0.1, theta, theta / [1.0, 1.0, 1.0 + DEVIATION / 2]) == pytest.approx(0.1)
