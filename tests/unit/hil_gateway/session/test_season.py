"""A season names what was changed in it and nothing else; its page says what was new then."""

from __future__ import annotations

import copy

import numpy as np
import pytest
from support.season import BEGAN_S, NAMES, sessions
from typer.testing import CliRunner
from unit.hil_gateway.session.test_day import write

from hil_gateway.cli.main import app
from hil_gateway.cli.track_day.reading import side_by_side
from hil_gateway.dashboard.day.season_page import page
from hil_gateway.process.errors import InputError
from hil_gateway.session.day.index import INDEX, read_day
from hil_gateway.session.day.season import season


def day_of(rows):
    return {"sessions": rows, "tyres": {}}


@pytest.mark.parametrize("resemblance", [0.0, 0.5, 0.8])
def test_of_seasons_in_which_nothing_changed_hardly_one_names_anything(resemblance):
    """1 % is asked for, of 25 seasons: three or more would come once in 500."""
    named = [season(day_of(sessions(seed, 120, resemblance)))["changes"] for seed in range(25)]
    assert sum(map(bool, named)) < 3, named


@pytest.mark.parametrize("seed", range(4))
def test_two_changes_are_found_where_they_were_made_and_none_other(seed):
    rows = sessions(seed, 300, 0.3)
    for s in rows[110:]:
        s["revisions"][-1]["parameters"]["aero_drag"]["c"] += 0.08
    for s in rows[200:]:
        s["tyres_believed"][0]["mean"] -= 0.1
    rows[110]["remarks"] = [{"t": 1.0, "text": "rear wing +2", "tyres": "", "air_c": None, "road_c": None}]
    found = season(day_of(rows))["changes"]
    assert [abs(change["session"] - made) <= 3 for change, made in zip(found, (111, 201), strict=True)] == [True] * 2
    assert [[one["name"] for one in change["moved"]] for change in found] == [["aero_drag c"], [NAMES[0]]]
    assert found[0]["moved"][0]["after"] - found[0]["moved"][0]["before"] == pytest.approx(0.08, abs=0.02)


def test_what_was_new_then_is_said():
    rows = sessions(1, 60, 0.0)
    for s in rows[30:]:
        s["best_lap_s"] += 5.0
        s["software"] = "2.0"
        s["tyres"] = {"B2": {"laps": 1, "km": 3.0}}
    rows[30]["remarks"] = [{"t": 1.0, "text": "harder springs", "tyres": "", "air_c": None, "road_c": None}]
    (change,) = season(day_of(rows))["changes"]
    assert change["session"] == 31
    assert change["new"] == ["software 1.0 to 2.0", "tyre set A1 to B2", '"harder springs" in session 31']


def test_wear_is_a_drift_and_warmth_is_told_from_time():
    rows, rng = sessions(2, 200, 0.0), np.random.default_rng(3)
    for n, s in enumerate(rows):
        road = float(rng.uniform(15.0, 45.0))
        s["weather"] = {"road_c": road}
        s["tyres_believed"][0]["mean"] -= 0.0005 * n
        s["tyres_believed"][1]["mean"] += 0.02 * (road - 30.0)
    found = season(day_of(rows))
    worn, warmed, *_ = (next(row for row in found["series"] if row["name"] == name) for name in NAMES)
    assert found["changes"] == []
    assert worn["drift"] == pytest.approx(-0.0005, rel=0.2) and worn["per_10_c"] is None
    assert warmed["per_10_c"] == pytest.approx(0.2, rel=0.2) and warmed["drift"] is None


def test_a_few_odd_sessions_are_no_change():
    rows = sessions(3, 80, 0.0)
    for n in (20, 21, 55):
        rows[n]["best_lap_s"] += 40.0
    assert season(day_of(rows))["changes"] == []


def test_sessions_that_say_nothing_and_such_as_cannot_be_read_are_no_trouble():
    rows = sessions(4, 3, 0.0)
    bare = copy.deepcopy(rows[0]) | {"number": 4, "tyres_believed": [], "revisions": [], "best_lap_s": None}
    broken = {"number": 5, "file": "bad.mcap", "unreadable": "no recording", "start_unix_s": BEGAN_S + 9e5}
    day = day_of([*rows, bare, broken])
    found = season(day)
    assert found["unreadable"] == ["bad.mcap"] and found["sessions"] == 5
    assert "not readable: bad.mcap" in page(found, day["sessions"])


def test_a_season_of_one_session_has_a_page_and_one_that_cannot_be_read_says_why(tmp_path):
    write(tmp_path / "day" / "session.mcap", 0.0, 1.2, "A1")
    assert CliRunner().invoke(app, ["season", str(tmp_path)]).exit_code == 0
    assert "aero_drag c" in (tmp_path / "season.html").read_text()
    (tmp_path / "broken" / "day").mkdir(parents=True)
    (tmp_path / "broken" / "day" / "junk.mcap").write_bytes(b"junk")
    refused = CliRunner().invoke(app, ["season", str(tmp_path / "broken")]).exception
    assert isinstance(refused, InputError) and "junk.mcap" in str(refused)


def test_days_are_read_side_by_side_as_one_after_the_other(tmp_path):
    for n in range(4):
        write(tmp_path / f"day{n}" / "session.mcap", 86400.0 * n, 1.2, "A1")
    done = CliRunner().invoke(app, ["season", str(tmp_path)])
    assert done.exit_code == 0, done.exception
    shown = (tmp_path / "season.html").read_text()
    assert "aero_drag c" in shown and "Nothing steps" in shown and "src=" not in shown
    together = read_day(tmp_path, side_by_side())
    (tmp_path / INDEX).unlink()
    assert read_day(tmp_path) == together
