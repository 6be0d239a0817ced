"""A survey of faults is drawn before it is driven: one seed, one survey, every fault once a track."""

from __future__ import annotations

from verification.fault_simulation.car_campaign import THEN
from verification.fault_simulation.car_faults import CAR_FAULTS
from verification.fault_simulation.survey import FIRST_S, LAST_S, NOTHING, PAIRS, Survey, draw


def names(survey: Survey) -> list[list[str]]:
    return [[THEN.join(fault.name for fault in pair) for _, pair in place] for _, place in survey.places]


def test_every_fault_is_drawn_once_a_track_and_every_place_is_driven_without_one_first() -> None:
    places = names(draw(7, 0, "oval"))
    drawn = [name for place in places for name in place[1:]]
    assert all(place[0] == NOTHING.name for place in places)
    assert sorted(name for name in drawn if THEN not in name) == sorted(fault.name for fault in CAR_FAULTS)
    assert sum(THEN in name for name in drawn) == PAIRS


def test_one_seed_gives_one_survey_and_another_seed_or_track_another() -> None:
    assert draw(7, 0, "oval") == draw(7, 0, "oval")
    assert names(draw(7, 0, "oval")) != names(draw(8, 0, "oval")) != names(draw(8, 1, "oval"))


def test_places_are_at_speed_in_order_of_time_and_no_noise_is_used_twice() -> None:
    survey = draw(7, 2, "oval")
    times = [time_s for time_s, _ in survey.places]
    seeds = [seed for _, place in survey.places for seed, _ in place]
    assert times[0] >= FIRST_S and times == sorted(times) and times[-1] <= LAST_S
    assert len(set(seeds)) == len(seeds)
