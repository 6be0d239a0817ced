"""A survey of faults is drawn before it is driven: one seed, one survey, every fault once a track."""

from __future__ import annotations

import math
import threading

import pytest

from benchmarks.campaign.run import with_bar
from benchmarks.faults import survey
from benchmarks.faults.car_campaign import NOTHING, THEN, FaultResult
from benchmarks.faults.car_faults import CAR_FAULTS
from benchmarks.faults.survey import ARMED_S, FAST_S, LAST_S, PAIRS, Survey, draw


def names(drawn: Survey) -> list[list[str]]:
    return [[THEN.join(fault.name for fault in pair) for _, pair in place] for _, place in drawn.places]


def test_every_fault_is_drawn_once_a_track_and_every_place_is_driven_without_one_first() -> None:
    places = names(draw(7, 0, "oval"))
    drawn = [name for place in places for name in place[1:]]
    assert all(place[0] == NOTHING.name for place in places)
    assert sorted(name for name in drawn if THEN not in name) == sorted(fault.name for fault in CAR_FAULTS)
    assert sum(THEN in name for name in drawn) == PAIRS


def test_one_seed_gives_one_survey_and_another_seed_or_track_another() -> None:
    assert draw(7, 0, "oval") == draw(7, 0, "oval")
    assert names(draw(7, 0, "oval")) != names(draw(8, 0, "oval")) != names(draw(8, 1, "oval"))


def test_one_place_is_in_the_first_seconds_the_others_are_at_speed_and_no_noise_is_used_twice() -> None:
    places = draw(7, 2, "oval").places
    times = [time_s for time_s, _ in places]
    seeds = [seed for _, place in places for seed, _ in place]
    assert ARMED_S <= times[0] <= FAST_S <= times[1] and times == sorted(times) and times[-1] <= LAST_S
    assert len(set(seeds)) == len(seeds)


@pytest.mark.parametrize(("margin_m", "false_stops"), [(0.5, 1), (-0.5, 0)])
def test_a_car_that_stops_without_a_fault_judges_none_and_is_named(
    monkeypatch: pytest.MonkeyPatch, margin_m: float, false_stops: int
) -> None:
    """It counts as a false stop where it had not left the road before."""
    stopped = FaultResult(NOTHING.name, 20.0, 50.0, 0.0, "yaw_rate_wrong", False, margin_m, margin_m)
    fault = FaultResult("steering stuck", 20.0, 50.0, None, "", False, -1.0, math.inf)
    monkeypatch.setattr(survey, "from_places", lambda *_, **__: iter([stopped, fault]))
    report = survey.run_survey(7, ["oval"])
    assert report["without a fault"]["false stops"] == false_stops
    assert report["without a fault"]["judge no fault"] == ["oval, car 7000, 20 s: yaw_rate_wrong"]
    assert report["all"]["single"]["faults"] == 0
    assert report["ok"] == (not false_stops)


@pytest.mark.parametrize(("why", "ok"), [("stop", False), ("physics", True)])
def test_a_survey_is_ok_only_where_stops_keep_to_the_road_or_physics_forbids_it(
    monkeypatch: pytest.MonkeyPatch, why: str, ok: bool
) -> None:
    drive = FaultResult(NOTHING.name, 20.0, 50.0, None, "", False, 0.5, 0.5)
    fault = FaultResult("steering stuck", 20.0, 50.0, 0.2, "steering_stuck", True, -1.0, 0.5, why)
    monkeypatch.setattr(survey, "from_places", lambda *_, **__: iter([drive, fault]))
    report = survey.run_survey(7, ["oval"])
    assert report["ok"] == ok
    assert report["all"]["single"]["kept"] == float(ok)


def test_a_survey_says_how_far_it_has_come(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    drive = FaultResult(NOTHING.name, 20.0, 50.0, None, "", False, 0.5, 0.5)
    fault = FaultResult("steering stuck", 20.0, 50.0, 0.2, "steering_stuck", True, -1.0, 0.5, "stop")
    monkeypatch.setattr(survey, "from_places", lambda *_, **__: iter([drive, fault]))
    survey.run_survey(7, ["oval"])
    drawn = sum(len(hand) for _, hand in draw(7, 0, "oval").places)
    said = capsys.readouterr().err
    assert f"2/{drawn}" in said
    assert "oval, 1 of 1: steering stuck" in said
    assert "oval, car 7000: FaultResult(fault='steering stuck'" in said


def test_a_bar_beside_results_for_which_the_process_forks_draws_from_no_thread() -> None:
    threads = [threading.active_count() for _ in with_bar(range(3), 3, str, forks=True)]
    assert threads == [threading.active_count()] * 3
