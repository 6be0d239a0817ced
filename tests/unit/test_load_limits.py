"""Envelope expansion: load limits widen only as far as the belief and the run support, and shrink at once."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil_gateway.errors import InputError
from planner.problem.load_limits import (
    HeldLoad,
    LoadLimits,
    RunEvidence,
    limit_within_run,
    load_limits,
    next_limit,
    store_limits,
)

positive = st.floats(0.2, 3.0)


@given(positive, positive, st.floats(0.0, 1.0), positive)
def test_next_limit_never_exceeds_what_belief_run_and_step_support(
    present: float, mean: float, std: float, held: float
) -> None:
    new = next_limit(present, RunEvidence(mean, std, held))
    supported = 0.97 * (mean - 2 * std)
    assert new <= max(0.1, supported) + 1e-12
    assert new <= 1.1 * present + 1e-12
    assert new <= max(present, 1.1 * held) + 1e-12


@given(positive, positive, positive)
def test_limits_widen_monotonically_as_the_belief_tightens(present: float, mean: float, held: float) -> None:
    limits = [next_limit(present, RunEvidence(mean, std, held)) for std in (0.5, 0.2, 0.1, 0.05, 0.0)]
    assert all(b >= a - 1e-12 for a, b in pairwise(limits))


def test_limits_shrink_at_once_when_the_belief_does_not_support_them() -> None:
    assert next_limit(1.3, RunEvidence(1.0, 0.05, 1.2)) == pytest.approx(0.97 * 0.9)


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


@given(positive, st.floats(0.1, 1.0), positive, positive)
def test_within_a_run_limits_never_widen_and_follow_the_lesser_grip(
    present: float, use: float, in_force: float, believed: float
) -> None:
    limit = limit_within_run(present, use, in_force, believed)
    assert limit <= present
    assert limit <= use * min(in_force, believed)
    assert limit in (present, use * in_force, use * believed)
