"""Results of the laboratory: pages are what the JSON says, and a new run takes the place of the one before."""

from __future__ import annotations

import pytest

from benchmarks.results import READERS, ROOT, keep, load

SINGLE = {
    "stops": 40, "kept": 0.975,
    "stops off the road": ["a", "b"], "off the road by physics": 1, "off the road unnoticed": [],
}  # fmt: skip
FOUND = {"single": SINGLE, "pairs": {"stops": 6, "kept": 0.5, "off the road unnoticed": ["a"]}}


@pytest.mark.parametrize("area", READERS)
def test_a_page_is_what_its_json_says(area: str) -> None:
    assert (ROOT / "docs" / "results" / f"{area}.md").read_text() == load(area).markdown()


def test_a_survey_takes_the_place_of_the_one_before() -> None:
    report = {"tracks": {"oval": FOUND}, "all": FOUND, "without a fault": {"places": 7, "false stops": 2}}
    page = keep("faults", "Survey 9830", report, "hil verify --fault-survey 9830")
    assert [table.heading for table in page.tables].count("Survey 9830") == 1
    assert "| 40 | 2 | 1 | 1 | 97.5 % | oval 97.5 % | 50.0 % of 6 | 2 of 7 |" in page.markdown()


def test_a_car_that_has_not_driven_its_laps_has_no_figure_for_them() -> None:
    car = {"seed": 7, "track": "oval", "lap_ratio": [1.2], "second_session_lap_ratio": None, "off_track": 0, "spins": 1}
    page = keep("laps", "One car", {"cars": [car]}, "hil campaign laps")
    assert "| 7 | oval | 1.200 | - | 1.200 | - | 0, 1 |" in page.markdown()


def test_a_car_counts_as_kept_where_it_drives_its_laps_on_the_road_and_unstopped() -> None:
    drive = {"track": "oval", "arrived": True, "stopped": [], "off_track": 0, "worst_margin_m": 0.52}
    stopped = drive | {"arrived": False, "stopped": [[35.0, "controlled_stop", "yaw_rate_wrong"]]}
    off = drive | {"off_track": 2, "worst_margin_m": -0.15}
    page = keep("effects", "Three cars", {"drives": [drive, stopped, off]}, "hil campaign cars")
    assert "| oval | 3 | 1 | 1 | 1 | -0.15 m |" in page.markdown()


def test_an_error_that_one_place_does_not_notice_has_no_size_that_every_place_does() -> None:
    place = {"source": "position off at once by", "unit": "m", "size": 0.9, "after_s": 0.4, "cause": "position_wrong"}
    other = place | {"size": 1.4, "after_s": 0.2}
    page = keep("least", "Two cars", [place, other, other | {"source": "late by", "size": None}], "least_noticed 1")
    assert "| position off at once by | 1.4 m | 1.4 m | 0.30 s | position_wrong |" in page.markdown()
    assert "| late by | - | - | - | - |" in page.markdown()
