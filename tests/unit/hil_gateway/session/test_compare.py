"""Two laps over distance: the gap is the difference of the times at the same place, on one page without a network."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from support.browser import Browser, needs_browser
from typer.testing import CliRunner

from hil_gateway.bus import messages as m
from hil_gateway.bus.topics import ESTIMATE, VEHICLE_STATE
from hil_gateway.cli.main import app
from hil_gateway.dashboard.compare_page import comparison, page
from hil_gateway.process.errors import InputError
from hil_gateway.session.files.writer import SessionFile
from hil_gateway.session.overview.lap_table import read_lap
from hil_gateway.session.overview.summary import session_summary
from hil_gateway.track.loading import load_track

ZEROS = tuple(
    name for name, field in m.VehicleState.model_fields.items() if field.annotation is float and name != "stamp_ns"
)
ONES = ("gear", "position_seq", "sys_state", "ct_state", "track_flag", "vehicle_flag")


def write(path: Path, speeds: list[float], unpushed_m: float = 0.0) -> Path:
    """Laps of the road course at constant speeds, 20 rows a second; in the first metres the heading is not known."""
    track, s, t, i = load_track(), 0.0, 0.0, 0
    with SessionFile(path, {"session": {"config": "{}"}}) as file:
        while s < track.length * len(speeds) + 10:
            speed = speeds[min(int(s / track.length), len(speeds) - 1)]
            stamp, at = round(t * 1e9), track.at(s)
            lacks = "heading" if s < unpushed_m else ""
            state = m.VehicleState(
                stamp_ns=stamp, seq=i, valid=True, sources={}, **dict.fromkeys(ZEROS, 0.0), **dict.fromkeys(ONES, 1)
            )
            estimate = m.Estimate(
                stamp_ns=stamp, seq=i, state_stamp_ns=stamp, valid=not lacks, lacks=lacks, x=float(at.x), y=float(at.y),
                yaw=0, vx=speed, vy=0, yaw_rate=0, bias_ax=0, bias_ay=0, bias_yaw_rate=0, std=(0.1,) * 9,
                steer=0, drive=0, innovations_rejected=0,
            )  # fmt: skip
            for topic, message in ((VEHICLE_STATE, state), (ESTIMATE, estimate)):
                file.add(topic.key, message.model_dump_json().encode(), stamp, stamp, i)
            s, t, i = s + 0.05 * speed, t + 0.05, i + 1
    return path


def test_the_gap_grows_as_the_speeds_say_and_ends_at_the_difference_of_the_lap_times(tmp_path):
    track = load_track()
    path = write(tmp_path / "a.mcap", [50.0, 60.0])
    slow, fast = read_lap(path, track, 1), read_lap(path, track, 2)
    assert read_lap(path, track).lap.number == 2
    data = comparison(fast, slow, track)
    s, delta = np.array(data["s"]), np.array(data["delta"])
    assert delta[50:-50] == pytest.approx(s[50:-50] * (1 / 50 - 1 / 60), abs=0.06)
    assert data["times_s"][1] - data["times_s"][0] == pytest.approx(track.length * (1 / 50 - 1 / 60), abs=0.1)
    assert set(np.round(fast.channels["speed"][5:-5], 3)) == {216.0}


def test_a_lap_from_rest_is_compared_from_its_first_metres_on_as_it_is_listed(tmp_path):
    path = write(tmp_path / "a.mcap", [10.0], unpushed_m=20.0)
    lap, (listed,) = read_lap(path, load_track()).lap, session_summary(path)["laps"]
    assert lap.from_rest and lap.time_s == pytest.approx(load_track().length / 10.0, abs=0.01)
    assert lap.tree() == {name: listed[name] for name in lap.tree()}


def test_what_cannot_be_compared_is_one_clear_line(tmp_path):
    track, path = load_track(), write(tmp_path / "a.mcap", [60.0])
    with pytest.raises(InputError, match="no lap 7; it holds the laps 1 to 1"):
        read_lap(path, track, 7)
    with pytest.raises(InputError, match="no complete lap of oval"):
        read_lap(path, load_track("oval"))
    said = CliRunner().invoke(app, ["session", "compare", str(path), str(path), "--lap", "1-2"])
    assert isinstance(said.exception, InputError)


def test_the_page_needs_no_other_file_and_no_network(tmp_path):
    path, out = write(tmp_path / "a.mcap", [50.0, 60.0]), tmp_path / "compare.html"
    arguments = ["session", "compare", str(path), str(path), "--lap", "1,2", "--out", str(out), "--json"]
    done = CliRunner().invoke(app, arguments)
    assert json.loads(done.stdout)["laps"] == [1, 2]
    text = out.read_text()
    assert "@DATA@" not in text and not re.search(r'(src|href)="', text)


@needs_browser
def test_a_browser_draws_both_laps_and_says_who_is_faster(tmp_path):
    track, path = load_track(), write(tmp_path / "a.mcap", [50.0, 60.0])
    (tmp_path / "c.html").write_text(page(read_lap(path, track, 1), read_lap(path, track, 2), track))
    with Browser(tmp_path / "profile") as browser:
        browser.open((tmp_path / "c.html").as_uri())
        browser.wait_for("document.querySelectorAll('.uplot').length === 7")
        assert browser.evaluate("document.getElementById('gap').textContent").endswith("faster")
        assert browser.evaluate("document.querySelectorAll('#sectors tbody tr').length") == 3
