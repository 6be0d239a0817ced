"""The search: what is exchanged, completed, removed, and started again."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from support.drives.practice_drives import PRIOR, record_of

from estimator.offline.diagnosis import alternatives
from estimator.offline.fit.prediction_error import Fit
from estimator.offline.search import every_car, greedy
from estimator.offline.search.acceptance import explains_more_than_is_left
from estimator.offline.search.empirical import SCREENING_STRIDE, Screening, Term, represented
from estimator.offline.search.every_car import on_every_car
from estimator.offline.search.evidence import Evidence, compare
from estimator.offline.search.greedy import Greedy, check_each
from estimator.offline.search.plausible import believed
from estimator.offline.search.screening import open_candidates
from estimator.offline.search.search import better, from_every_car, prefer_effects, search, without_proxies
from estimator.offline.search.trial import Setting, fit_names


def _quiet(_: str) -> None:
    """Progress that nobody watches."""


def _never_enough(_base: Fit, _current: Fit) -> bool:
    return False


def test_a_term_leaves_its_constant_to_an_accepted_effect_that_has_it(drives: dict[str, Any]) -> None:
    setting, accepted = Setting(record_of(drives["single"]), "per_axle", PRIOR), ["rolling_resistance"]
    base = fit_names(setting, accepted, None)
    screening = Screening.make(setting, accepted, base, thinned=False)
    free = Term("force_x", "steer", setting.record.bases["steer"], compare(*[base.held_out()] * 2, base.normal.count))
    assert screening.levelled(free, []) == free
    level = screening.levelled(free, accepted)
    fits = [fit_names(term.added_to(setting), accepted, base, exact=True) for term in (free, level)]
    rows = [next(b for b in f.predictor.blocks if b.effect.name == "rolling_resistance").parameters for f in fits]
    error = [float(np.sqrt(f.covariance[r, r][0, 0])) for f, r in zip(fits, rows, strict=True)]
    assert error[1] < 0.2 * error[0], "of a constant that both have neither is known"
    assert fits[1].parameters[rows[1]][0] == pytest.approx(420.0, rel=0.02)


def test_what_stands_in_for_another_effect_is_exchanged_for_it(drives: dict[str, Any]) -> None:
    record = record_of(drives["pair"])
    record = record.select(np.arange(record.windows) % 2 == 0)
    setting = Setting(replace(record, lap=np.arange(record.windows) // 8), "per_axle", PRIOR)
    start, names = fit_names(setting, (), None), ["rolling_resistance", "steer_offset"]
    state = Greedy(setting, _quiet, _never_enough, start, names, fit_names(setting, names, start), [])
    state.recheck()
    assert state.names == names, "it stands in well"
    assert state.exchange()
    assert set(state.names) == {"aero_drag", "steer_offset"}


@pytest.mark.parametrize(
    ("drive", "others", "ends"),
    [("drift", ["rolling_resistance"], "grip_drift"), ("stiffer", [], "stiffness_drift")],
)
def test_a_look_alike_that_does_not_lead_gives_way_to_the_effect_that_it_resembles(
    drives: dict[str, Any], drive: str, others: list[str], ends: str
) -> None:
    setting, names = Setting(record_of(drives[drive]), "per_axle", PRIOR), [*others, "stiffness_drift"]
    start = fit_names(setting, (), None)
    state = Greedy(setting, _quiet, _never_enough, start, names, fit_names(setting, names, start), [])
    state.recheck()
    assert state.names == names, "it stands in well"
    prefer_effects(state)
    assert set(state.names) == {*others, ends}


def test_an_effect_that_is_not_believed_is_tried_in_its_other_form_before_it_is_dropped(
    drives: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    record = record_of(drives["much"])
    setting = Setting(record.select(np.arange(record.windows) % 2 == 0), "per_axle", PRIOR)
    names = ["aero_downforce", "combined_slip", "limited_slip"]
    start = fit_names(setting, names, None)
    monkeypatch.setattr(greedy, "believed", lambda fit, name: name != "limited_slip" and believed(fit, name))
    found, _, checked = greedy.recheck(setting, names, start, _quiet)
    assert set(found) == set(checked.gains) == {"aero_downforce", "combined_slip", "yaw_damping"}


@pytest.mark.parametrize(
    ("drive", "effect", "there"), [("pulses", "front_brake", False), ("single", "rolling_resistance", True)]
)
def test_what_takes_out_the_mean_of_a_force_that_comes_and_goes_explains_less_than_it_leaves(
    drives: dict[str, Any], drive: str, effect: str, there: bool
) -> None:
    record = record_of(drives[drive])
    record = record.select(np.arange(record.windows) % 4 == 0)
    setting = Setting(replace(record, lap=np.arange(record.windows) // 8), "per_axle", PRIOR)
    start = fit_names(setting, (), None)
    done = fit_names(setting, [effect], start)
    gain = compare(start.held_out(), done.held_out(), done.normal.count)
    assert gain.gain > 0.02 * record.rows.shape[0] * record.rows.shape[1], "worth a name by its gain alone"
    assert explains_more_than_is_left(effect, gain.channel, start, done) == there


@pytest.mark.parametrize(("row", "unexplained", "named"), [(1, 0.0, True), (1, 3.0, False), (2, 0.1, False)])
def test_what_turns_the_car_is_named_only_where_it_explains_more_of_lateral_force_and_turning_than_is_left(
    drives: dict[str, Any], row: int, unexplained: float, named: bool
) -> None:
    record = record_of(drives["play"])
    measured = record.measured.copy()
    measured[row] += unexplained * np.sign(np.sin(record.signals["t"]))
    record = replace(record, measured=measured).select(np.arange(record.windows) % 12 == 0)
    setting = Setting(replace(record, lap=np.arange(record.windows) // 4), "per_axle", PRIOR)
    start = fit_names(setting, (), None)
    done = fit_names(setting, ["steer_play"], start)
    assert explains_more_than_is_left("steer_play", 2, start, done) == named


def test_what_every_car_has_is_found_together_where_part_of_it_shows(drives: dict[str, Any]) -> None:
    setting = Setting(record_of(drives["car"]), "per_axle", PRIOR)
    for shown, complete in ((["aero_drag", "aero_downforce"], True), (["aero_drag"], False)):
        base, current = fit_names(setting, [], None), fit_names(setting, shown, None)
        state = Greedy(setting, _quiet, _never_enough, base, shown, current, [])
        assert state.complete() == complete
        assert {"load_transfer", "combined_slip"} <= set(state.names) or not complete
        assert set(state.names) <= set(drives["car"].effects)
        assert not state.complete(), "beside the same effects it is tried once"


def test_what_the_quadratic_calls_idle_stays_where_the_fit_without_it_is_worse(
    drives: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    setting = Setting(record_of(drives["car"]), "per_axle", PRIOR)
    shown = ["aero_drag", "aero_downforce"]
    current, by_quadratic = fit_names(setting, shown, None), every_car.gain_beside_others

    def misjudged(fit: Fit, name: str) -> Evidence:
        evidence = by_quadratic(fit, name)
        return replace(evidence, gain=-1e6) if name == "load_transfer" else evidence

    monkeypatch.setattr(every_car, "gain_beside_others", misjudged)
    names, _ = every_car.with_every_car(setting, shown, current)
    assert {"load_transfer", "combined_slip"} <= set(names) <= set(drives["car"].effects)


@pytest.mark.long
def test_a_second_start_leaves_what_stands_in_for_several_effects(drives: dict[str, Any]) -> None:
    setting = Setting(record_of(drives["car"]), "per_axle", PRIOR)
    base, wrong = fit_names(setting, [], None), ["rolling_resistance", "steer_scale"]
    first = Greedy(setting, _quiet, _never_enough, base, wrong, fit_names(setting, wrong, None), [])
    second = from_every_car(first)
    assert set(second.names) == set(drives["car"].effects)
    assert better(first, second) is second
    assert better(second, first) is second
    assert {trial.name for trials in second.rounds for trial in trials} >= set(second.names), "a report lists all"


@pytest.mark.parametrize("thorough", [pytest.param(True, marks=pytest.mark.long), False])
def test_a_thorough_search_ends_with_the_better_of_two_starts(
    drives: dict[str, Any], monkeypatch: pytest.MonkeyPatch, thorough: bool
) -> None:
    setting, run, wrong = (
        Setting(record_of(drives["car"]), "per_axle", PRIOR),
        Greedy.run,
        ["steer_scale", "yaw_damping"],
    )

    def misled(state: Greedy) -> None:
        if state.names:
            run(state)
        else:
            state.names, state.fit = wrong, fit_names(setting, wrong, None)
            state.checked = check_each(setting, wrong, state.fit, _quiet)

    monkeypatch.setattr(Greedy, "run", misled)
    found = search(setting, thorough=thorough)
    assert set(found.accepted) == set(drives["car"].effects if thorough else wrong)
    if thorough:
        tried_instead = {t.name for name in found.accepted for t in alternatives(found, name)}
        assert not tried_instead & set(found.accepted), "what was found together is not tried in each other's place"


def test_what_stands_in_is_removed_unless_the_car_shows_what_every_car_has(drives: dict[str, Any]) -> None:
    record = record_of(drives["pulses"])
    record = record.select(np.arange(record.windows) % 4 == 0)
    setting = Setting(replace(record, lap=np.arange(record.windows) // 8), "per_axle", PRIOR)
    alone, two = ["front_brake"], ["front_brake", "aero_drag"]
    for names, kept in ((alone, False), (two, False), ([*two, "rolling_resistance"], True)):
        done = fit_names(setting, names, None)
        checked, _ = without_proxies(setting, check_each(setting, names, done, _quiet), done, _quiet)
        assert ("front_brake" in checked.gains) == kept


def test_of_two_starts_what_stands_in_does_not_count(drives: dict[str, Any]) -> None:
    record = record_of(drives["pulses"])
    signals = {**record.signals, "steer": record.signals["steer"] + 0.00015}
    record = replace(record, signals=signals).select(np.arange(record.windows) % 4 == 0)
    setting = Setting(replace(record, lap=np.arange(record.windows) // 8), "per_axle", PRIOR)
    base = fit_names(setting, (), None)
    first, second = (
        Greedy(setting, _quiet, _never_enough, base, names, fit_names(setting, names, base), [])
        for names in (["front_brake"], ["steer_offset"])
    )
    assert first.total > second.total, "what stands in for pulses predicts better than without"
    for state in (first, second):
        state.recheck()
    assert better(first, second) is second


def test_of_two_forms_of_one_effect_a_model_has_one(drives: dict[str, Any]) -> None:
    drive = drives["none"]
    columns = drive.columns | {"brake": np.maximum(-drive.columns["drive"], 0.0), "throttle": 0.0 * drive.columns["t"]}
    setting = Setting(record_of(replace(drive, columns=columns)), "per_axle", PRIOR)
    both = {"front_brake", "brake_pressure"}
    assert [both & set(names) for names in on_every_car(setting, [])] == [{"brake_pressure"}, {"front_brake"}]
    assert both <= {effect.name for effect in open_candidates(setting, [])}
    for form in both:
        assert not both & {effect.name for effect in open_candidates(setting, [form])}


def test_what_is_left_in_few_windows_is_not_told_by_every_fourth() -> None:
    rng = np.random.default_rng(7)
    even = 1.0 + np.mean(rng.normal(size=(5, 160, 20)) ** 2, axis=2)
    local = even.copy()
    local[2, 40:160:40] += 200.0
    assert represented(even, SCREENING_STRIDE)
    assert not represented(local, SCREENING_STRIDE)


def test_a_gyroscope_that_drifts_is_told_at_its_place(drives: dict[str, Any]) -> None:
    drive = drives["none"]
    t = drive.columns["t"]
    record = record_of(replace(drive, columns=drive.columns | {"yaw_rate": drive.columns["yaw_rate"] + 2e-5 * t}))
    record = record.select(np.arange(record.windows) % 6 == 0)
    setting = Setting(replace(record, lap=np.arange(record.windows) // 4), "per_axle", PRIOR)
    best = Screening.make(setting, (), fit_names(setting, (), None), thinned=False).terms()[0]
    assert best.place == "gyro"


@pytest.mark.parametrize("over", [False, True])
def test_a_search_whose_time_is_over_begins_no_further_round(monkeypatch: pytest.MonkeyPatch, over: bool) -> None:
    rounds: list[int] = []
    monkeypatch.setattr(greedy, "_round", lambda *_: rounds.append(1) or [])
    monkeypatch.setattr(Greedy, "total", 0.0)
    nothing: Any = None
    setting = Setting(nothing, "per_axle", PRIOR, over=lambda: over)
    state = Greedy(setting, _quiet, _never_enough, nothing, [], nothing, [])
    state.run()
    assert len(rounds) == (0 if over else 1)
    assert state.names == []
