"""Another grip on a stretch of the track: found with its place, laps and size, or not at all."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.drives.practice_drives import PRIOR, record_of

from estimator.offline import diagnosis
from estimator.offline.record.record import SPUN, Record
from estimator.offline.report.words import grip_words
from estimator.offline.search.evidence import Evidence
from estimator.offline.search.stretches.cells import CELL_M, FORMS, GRIP_STD, LONGEST_SHARE, Candidate, Cells, Stretch
from estimator.offline.search.stretches.term import StretchTerm, localised, without
from estimator.offline.search.trial import Setting, fit_names

COUNT, LAPS, WEIGHT = 60, 5, 4000.0


def _cells(start: int, stop: int, laps: set[int], change: float) -> Cells:
    """Cells of which those from `start` to `stop` in some laps pull towards a change of grip; the others say none."""
    inside = np.zeros((LAPS, COUNT))
    inside[sorted(laps), start:stop] = 1.0
    curvature = np.broadcast_to(WEIGHT * np.eye(COUNT), (LAPS, COUNT, COUNT))
    return Cells(CELL_M * np.arange(COUNT + 1), np.arange(LAPS), WEIGHT * change * inside, curvature, FORMS[0])


@given(
    st.integers(0, COUNT - 2),
    st.integers(1, int(LONGEST_SHARE * COUNT)),
    st.sets(st.integers(0, LAPS - 1), min_size=1),
    st.sampled_from([-0.3, -0.1, 0.2]),
)
def test_the_cells_that_pull_together_are_the_stretch(start: int, length: int, laps: set[int], change: float) -> None:
    stop = min(start + length, COUNT)
    found = _cells(start, stop, laps, change).most_gaining()
    assert (found.stretch.start, found.stretch.end) == (CELL_M * start, CELL_M * stop)
    assert found.stretch.laps == tuple(sorted(laps))
    assert found.stretch.every_lap == (len(laps) == LAPS)
    weight = WEIGHT * (stop - start) * len(laps)
    assert found.change == pytest.approx(change * weight / (weight + GRIP_STD**-2))


def test_a_stretch_of_the_longest_length_says_that_it_may_be_part_of_more() -> None:
    most = int(LONGEST_SHARE * COUNT)
    assert _cells(2, 2 + most + 3, {4}, -0.3).most_gaining().longest
    assert not _cells(2, 2 + most // 2, {4}, -0.3).most_gaining().longest


def test_a_lap_too_gentle_to_tell_does_not_speak_against_every_lap() -> None:
    cells = _cells(10, 20, {1, 2, 3, 4}, -0.3)
    gentle = np.array([1e-4, 1.0, 1.0, 1.0, 1.0])
    found = replace(cells, curvature=gentle[:, None, None] * cells.curvature).most_gaining()
    assert found.stretch.every_lap


@pytest.fixture(scope="module")
def patched(drives: dict[str, Any]) -> Record:
    record = record_of(drives["patch"])
    return replace(record, lap=np.arange(record.windows) // 5)


def test_a_patch_of_every_lap_is_found_with_its_length_and_grip(patched: Record, drives: dict[str, Any]) -> None:
    setting = Setting(patched, "per_axle", PRIOR)
    local = localised(setting, ["aero_drag"], fit_names(setting, ["aero_drag"], None), 100.0)
    assert local is not None
    found, share = local
    assert found.stretch.every_lap
    assert found.stretch.end - found.stretch.start == pytest.approx(0.07 * patched.lap_length, abs=3 * CELL_M)
    assert found.change == pytest.approx(-drives["patch"].effects["grip_patch"], abs=0.03)
    assert found.hook is FORMS[0], "its stiffness fell as much"
    assert share > 0.5


def test_a_patch_of_one_lap_is_found_in_that_lap(drives: dict[str, Any]) -> None:
    wet = record_of(drives["patch"])
    setting = Setting(replace(wet, lap=np.arange(wet.windows) // 5), "per_axle", PRIOR)
    fit = fit_names(setting, ["aero_drag"], None)
    local = localised(setting, ["aero_drag"], fit, 100.0)
    assert local is not None
    laps = np.unique(wet.lap_of_row)
    kept = [replace(local[0].stretch, laps=(int(lap),), every_lap=False) for lap in laps[:-1]]
    one = replace(setting, record=without(setting.record, kept))
    found = localised(one, ["aero_drag"], fit_names(one, ["aero_drag"], fit), 50.0)
    assert found is not None
    assert found[0].stretch.laps == (int(laps[-1]),)
    assert not found[0].stretch.every_lap


def test_what_is_left_out_are_the_windows_on_the_stretch(patched: Record) -> None:
    stretch = Stretch(300.0, 400.0, (1, 2), False)
    left = without(patched, [stretch])
    assert 0 < patched.windows - left.windows < 0.2 * patched.windows
    assert not left.thin(stretch.covers(left)).any()
    assert set(np.unique(left.lap)) == set(range(int(left.lap.max()) + 1))


@pytest.mark.parametrize(("laps", "gains", "repeats"), [
    ((1, 2), 5.0, True), ((1,), 5.0, False), ((1, 2), -5.0, False),
])  # fmt: skip
def test_a_stretch_repeats_where_it_gains_in_more_than_one_lap(
    patched: Record, laps: tuple[int, ...], gains: float, repeats: bool
) -> None:
    stretch = Stretch(300.0, 400.0, laps, False)
    term = StretchTerm.of(Candidate(stretch, FORMS[0], 1.0, -0.3, 0.01))
    acts = patched.thin(stretch.covers(patched)).any(axis=1)
    by_group = np.full(int(patched.lap.max()) + 1, -1.0)
    by_group[np.unique(patched.lap[acts])] = gains
    assert replace(term, evidence=Evidence(1.0, np.ones(5), by_group)).repeats(patched) == repeats


def test_words_say_place_laps_and_size() -> None:
    stretch = Stretch(440.0, 741.0, (3, 5), False)
    assert grip_words(stretch, -0.26, 0.01) == (
        "from s = 440 to 741 m, in laps 3 and 5, the grip of both axles is 26 ± 1 % lower"
    )
    assert "in laps 3 to 6," in grip_words(replace(stretch, laps=(3, 4, 5, 6)), -0.26, 0.01)
    assert "in every lap," in grip_words(replace(stretch, every_lap=True), 0.1, 0.01)


def test_what_leads_to_a_spin_is_left_out_with_it(drives: dict[str, Any]) -> None:
    drive = drives["none"]
    columns = {name: values.copy() for name, values in drive.columns.items()}
    start, length = len(columns["t"]) // 2, 300
    ramp = np.linspace(0.0, 1.2 * SPUN, length)
    rows = slice(start, start + length)
    columns["vy"][rows] += ramp * columns["vx"][rows]
    kept = record_of(replace(drive, columns=columns)).rows
    spun = start + int(length / 1.2)
    assert not np.isin(np.arange(start + 60, spun), kept).any()
    assert np.isin(start - 400, kept)


@pytest.mark.parametrize(
    ("longest", "every_lap", "said"), [(False, False, True), (True, False, False), (True, True, True)]
)
def test_another_grip_as_long_as_any_that_is_sought_is_said_of_a_place_only_where_every_lap_has_it(
    drives: dict[str, Any], monkeypatch: pytest.MonkeyPatch, longest: bool, every_lap: bool, said: bool
) -> None:
    record = record_of(drives["patch"])
    current = fit_names(Setting(replace(record, lap=np.arange(record.windows) // 15), "per_axle", PRIOR), (), None)
    found = Candidate(Stretch(0.0, 900.0, (3,), every_lap), FORMS[0], 1e6, -0.3, 0.02, longest)
    monkeypatch.setattr(diagnosis, "most_gaining", lambda *_: found)
    assert (diagnosis._other_grip(record, current) is found) == said
