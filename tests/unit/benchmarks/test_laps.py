"""`hil campaign laps`: cars are dealt out, figures come from the plant, a finished car is not driven again."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks.campaign.laps import LapsTrial, figures, summarise, trials
from benchmarks.campaign.run import Machines, drive_all, save
from hil_gateway.plant.car_file import read_car
from planner.simulation.loop import LoopResult


def car(ratios: list[float], **more: object) -> dict[str, object]:
    usual = {
        "settings": {"laps": len(ratios)}, "lap_times_s": ratios, "second_session": {"lap_times_s": [80.0, 80.0]},
        "without_learning": None, "off_track": 0, "spins": 0, "slides": 0, "second_session_lap_ratio": 1.1,
    }  # fmt: skip
    return {"lap_ratio": ratios, **usual, **more}


def test_cars_are_dealt_out_over_the_tracks_in_turn() -> None:
    jobs = trials(range(7, 11), ("oval", "tri_oval"), 3, None, without=False)
    assert [job.name for job in jobs] == ["laps-007-oval", "laps-008-tri_oval", "laps-009-oval", "laps-010-tri_oval"]


def test_every_seed_is_another_car_and_the_same_every_time() -> None:
    first, again, other = (LapsTrial(seed, "oval", 3).simulated() for seed in (5, 5, 6))
    assert first == again
    assert first != other


def test_a_stored_car_is_not_driven_again(tmp_path: Path) -> None:
    job = LapsTrial(5, "oval", 3).job()
    stored = {"settings": dict(job.settings), "seed": 5}
    save(tmp_path, job.name, stored)
    assert drive_all([job], tmp_path, Machines(1)) == [stored]


def test_a_car_with_events_is_driven_as_its_file_says_and_once(tmp_path: Path) -> None:
    """A wet stretch on every lap lasts for ever: infinity goes through the stored result too."""
    file = tmp_path / "car.json"
    wet = {"kind": "grip", "s": 300, "for_m": 200, "factor": 0.8}
    events = [wet, {"kind": "brake_fade", "t": 60, "for_s": 6, "factor": 0.7}]
    file.write_text(json.dumps({"mass": 800, "events": events}))
    job = trials([5], ("oval",), 3, file, without=True)[0]
    assert LapsTrial(**job.settings).simulated() == read_car(file)
    save(tmp_path, job.name, {"settings": dict(job.settings), "seed": 5})
    assert drive_all([job], tmp_path, Machines(1))[0]["seed"] == 5


def test_the_median_counts_cars_that_drove_the_lap() -> None:
    summary = summarise([car([1.5, 1.2]), car([1.3, 1.1]), car([1.4], off_track=2)])
    assert summary["median_ratio"] == {"1": pytest.approx(1.4), "2": pytest.approx(1.15)}
    assert summary["off_track"] == 2


def test_laps_that_no_car_drove_are_missing_in_every_session() -> None:
    none = {"lap_times_s": []}
    stopped = car([1.3], settings={"laps": 3}, second_session=none, without_learning=none)
    assert summarise([car([1.5, 1.2]), stopped])["laps_missing"] == 2 + 2 + 3


def test_ratios_are_lap_times_over_the_limit() -> None:
    assert figures(LoopResult(lap_times_s=[110.0, 100.0]), 80.0)["lap_ratio"] == [1.375, 1.25]
