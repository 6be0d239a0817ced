"""A day is what its recordings say: the index comes back equal, the page says what was driven, and it can be shared."""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path
from zipfile import ZipFile

import pytest
from support.cars.session_rig import UNIX_NS, Rig
from typer.testing import CliRunner
from unit.hil_gateway.session.test_catalogue import SPEED, estimate, stop

from hil_gateway.bus import messages as m
from hil_gateway.bus.topics import BELIEF, ESTIMATE, EVENT, GATEWAY_STATUS, MODEL_REVISION, NOTE, PLAN, RUN
from hil_gateway.bus.track_day.note import Note
from hil_gateway.bus.track_day.run import RunPhase, RunPlan, RunStatus
from hil_gateway.cli.main import app
from hil_gateway.dashboard.day.page import page
from hil_gateway.process.errors import InputError
from hil_gateway.session.day.index import INDEX, read_day, read_in_turn
from hil_gateway.session.files.reader import SessionReader
from hil_gateway.session.files.recover import recover
from hil_gateway.session.files.writer import SessionFile
from hil_gateway.session.overview.outing import Outing
from hil_gateway.track.lap_clock import Lap
from hil_gateway.track.loading import load_track

LAP_S = load_track().length / SPEED


def write(path: Path, day_s: float, laps: float, tyres: str, track: str = "") -> Path:
    """Laps on the centre line, `day_s` into the day, on a tyre set and then on another; stopped at the end."""
    path.parent.mkdir(parents=True, exist_ok=True)
    config = {"recorder": {"folder": str(path.parent.absolute())}, "track": track}
    course, seconds = load_track(), laps * LAP_S
    with SessionFile(path, {"session": {"started": "", "software": "1.0", "config": json.dumps(config)}}) as file:

        def add(topic, t_s: float, message) -> None:
            stamp_ns = UNIX_NS + round((day_s + t_s) * 1e9)
            file.add(topic.key, message.model_dump_json().encode(), stamp_ns, stamp_ns, message.seq)

        add(RUN, 0.0, run_status(RunPhase.OUT_LAP, tyres))
        for i in range(round(10 * seconds)):
            at = course.at(SPEED * i / 10 - 300.0)
            if i == round(15 * LAP_S):
                add(NOTE, i / 10, Note(stamp_ns=1, seq=0, source="t", text="front wing +1", tyres="B2"))
            add(ESTIMATE, i / 10, estimate(i * 10**8, float(at.x), float(at.y)))
        add(
            RUN,
            seconds,
            run_status(RunPhase.DONE, tyres, clean=False, said="stopped; not clean, caps stay: the car slid"),
        )
        effect = m.ActiveEffect(name="aero_drag", parameters={"c": 1.25})
        learnt = m.Provenance(error_before={"ax": 0.5}, error_after={"ax": 0.125})
        add(MODEL_REVISION, seconds, m.ModelRevision(
            stamp_ns=1, seq=0, revision="r1", layout="shared", tyre={"cx": 1}, effects=(effect,), provenance=learnt,
        ))  # fmt: skip
        add(BELIEF, seconds, m.Belief(
            stamp_ns=1, seq=0, layout="shared", names=("d",), mean=(1.5,), covariance=((0.01,),), samples=1,
            log_det_information=0.0,
        ))  # fmt: skip
        add(EVENT, seconds, stop(round(seconds * 1e9)))
    return path


def run_status(phase: RunPhase, tyres: str, clean: bool | None = None, said: str = "") -> RunStatus:
    plan = RunPlan(laps=2, tyres=tyres, fuel_kg=40.0, notes="base setup")
    return RunStatus(
        stamp_ns=1, seq=0, phase=phase, number=1, plan=plan, speed_cap=30.0, load_cap=0.5, caps_from="default",
        clean=clean, said=said,
    )  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    place = tmp_path / "day"
    write(place / "one" / "session.mcap", 0.0, 2.3, "A1")
    write(place / "two" / "session.mcap", 3600.0, 1.3, "A1")
    (place / "bad.mcap").write_bytes(b"no recording")
    return place


def test_the_index_is_made_of_the_recordings_alone(folder):
    read = []

    def counted(sessions):
        read.extend(sessions)
        return read_in_turn(sessions)

    day = read_day(folder, counted)
    assert len(read) == 3
    assert read_day(folder, counted) == day and len(read) == 3
    (folder / INDEX).unlink()
    assert read_day(folder) == day


def test_laps_and_kilometres_are_on_the_tyres_that_were_on(folder):
    day = read_day(folder)
    one, two = (s for s in day["sessions"] if "laps" in s)
    assert [lap["tyres"] for lap in one["laps"]] == ["A1", "B2"] and [lap["tyres"] for lap in two["laps"]] == ["A1"]
    assert one["km"] == pytest.approx(2.3 * load_track().length / 1000, rel=0.01)
    assert day["tyres"]["A1"]["laps"] == 2 and day["tyres"]["B2"]["laps"] == 1
    assert sum(used["km"] for used in day["tyres"].values()) == pytest.approx(one["km"] + two["km"], abs=0.01)


def test_the_page_answers_what_was_driven_found_and_said(folder):
    done = CliRunner().invoke(app, ["day", str(folder)])
    assert done.exit_code == 0, done.exception
    text = (folder / "day.html").read_text()
    for said in (
        "front wing +1", "base setup", "aero_drag: c 1.25", "ax 0.5 to 0.125", "command_stale", "0.11 s, limit 0.1 s",
        "not clean, caps stay: the car slid", "30 m/s, 50 % of the grip (default)", "tyre set B2", "bad.mcap",
    ):  # fmt: skip
        assert said in text, said
    assert "http" not in text and "src=" not in text


def test_the_page_says_where_the_car_stopped_and_how_far_its_run_went(folder):
    one = next(s for s in read_day(folder)["sessions"] if "laps" in s)
    stopped, (run,) = one["stops"][0], one["runs"]
    track = load_track()
    assert stopped["place_m"] == pytest.approx((2.3 * track.length - 300.0) % track.length, abs=SPEED / 5)
    assert (stopped["lap"], stopped["run"], stopped["again_s"]) == (3, 1, None)
    assert run["km"] == pytest.approx(2.3 * track.length / 1000, rel=0.01) and run["top_speed"] == SPEED
    assert run["seconds"] == pytest.approx(2.3 * LAP_S, abs=0.2)


def test_the_page_says_how_the_car_stands_in_its_box(tmp_path):
    track = load_track("oval")
    x, y, yaw = track.box_pose(track.pit_lane.boxes[2])
    c, s = math.cos(yaw), math.sin(yaw)
    path = tmp_path / "session.mcap"
    with SessionFile(path, {"session": {"started": "", "software": "1.0", "config": '{"track": "oval"}'}}) as file:
        for i, (speed, ahead) in enumerate(((0.4, -0.5), (0.0, -0.25), (0.0, -0.25), (3.0, 9.0), (0.0, 99.0))):
            stands = {"vx": speed, "yaw": yaw - 0.02, "x": x + ahead * c - 0.1 * s, "y": y + ahead * s + 0.1 * c}
            status = run_status(RunPhase.DONE, "").model_copy(update={"box": 3, "in_pit_lane": True})
            for topic, message in ((ESTIMATE, estimate(i, 0.0, 0.0).model_copy(update=stands)), (RUN, status)):
                file.add(topic.key, message.model_dump_json().encode(), UNIX_NS + i * 10**9, UNIX_NS + i * 10**9, i)
    (run,) = read_day(tmp_path)["sessions"][0]["runs"]
    stands = {"box": 3, "ahead_m": -0.25, "left_m": 0.1, "turned_rad": -0.02}
    assert run["parked"] == pytest.approx(stands, abs=1e-6)
    assert "in box 3: 0.25 m short, 0.10 m left, turned 1.1 deg right" in page(read_day(tmp_path))


def test_runs_of_a_planner_that_was_started_again_are_others_and_no_lap_is_of_a_run_that_nobody_knows():
    outing, lap = Outing(), Lap(1, 0.0, 50.0, (17.0, 17.0, 16.0))
    outing.take_run(0.0, run_status(RunPhase.FLYING, "A1"))
    outing.take_run(1.0, RunStatus(stamp_ns=1, seq=1, phase=RunPhase.NONE, number=0))
    outing.moved(2.0, 30.0, lap)
    outing.take_run(3.0, run_status(RunPhase.FLYING, "B2"))
    outing.moved(4.0, 30.0, lap)
    tree = outing.tree()
    assert [(run["number"], run["tyres"]) for run in tree["runs"]] == [(1, "A1"), (2, "B2")]
    assert "started again" in tree["runs"][0]["said"] and [lap["run"] for lap in tree["laps"]] == [0, 2]


def test_tyres_that_the_car_stood_on_are_not_those_that_were_driven():
    """Until a person says which set is on the car stands, and its estimated speed is not quite nothing."""
    outing = Outing()
    for second in range(60):
        outing.moved(float(second), 0.05, None)
    outing.take_run(60.0, run_status(RunPhase.FLYING, "A1"))
    outing.moved(60.0, 30.0, None)
    assert outing.tree()["tyres"] == {"A1": {"laps": 0, "km": 0.03}}


def test_a_gateway_that_was_killed_while_it_drove_is_a_stop_with_its_cause(tmp_path):
    path = tmp_path / "session.mcap"
    with SessionFile(path, {"session": {"started": "", "software": "1.0", "config": "{}"}}) as file:
        file.add(PLAN.key, b"{}", UNIX_NS, UNIX_NS, 0)  # times count from what was recorded first, whatever it is
        for seconds, seq, action in ((1, 10, "drive"), (2, 20, "drive"), (7, 0, "silent"), (8, 10, "silent")):
            status = gateway_status(seconds * 10**9, seq, action)
            stamp_ns = UNIX_NS + status.stamp_ns
            file.add(GATEWAY_STATUS.key, status.model_dump_json().encode(), stamp_ns, stamp_ns, seq)
    (session,) = read_day(tmp_path)["sessions"]
    (stopped,) = session["stops"]
    assert (stopped["t"], stopped["cause"]) == (2.0, "gateway_gone") and "5.0 s later" in stopped["text"]
    assert [event["after"] for event in session["happened"]] == ["gateway silent"]


def gateway_status(now_ns: int, seq: int, action: str) -> m.GatewayStatus:
    return m.GatewayStatus(
        stamp_ns=now_ns, seq=seq, armed=action == "drive", action=action, cause="", missing_for_arming=(), mode="armed",
        bus="udp", bus_state="error_active", frames_received=0, frames_lost=0, frames_unknown=0, frames_malformed=0,
        counter_errors=0, commands_sent=0, commands_limited=0, loop_latency_p50_ms=None, loop_latency_p99_ms=None,
    )  # fmt: skip


def test_two_laps_of_the_day_are_compared(folder, tmp_path):
    with pytest.raises(InputError, match=r"lap 1\.9: not one of this day"):
        CliRunner().invoke(app, ["day", "compare", str(folder), "1.9", "1.1"], catch_exceptions=False)


def test_a_shared_day_opens_elsewhere_and_names_no_folder_of_this_computer(folder, tmp_path):
    track = tmp_path / "private place" / "ours.csv"
    track.parent.mkdir()
    course = load_track()
    rows = zip(course.x, course.y, course.width_right, course.width_left, strict=True)
    track.write_text("x_m,y_m,w_tr_right_m,w_tr_left_m\n" + "".join(f"{','.join(map(str, row))}\n" for row in rows))
    write(folder / "three" / "session.mcap", 7200.0, 1.3, "C3", str(track))
    whole, out = read_day(folder), tmp_path / "day.zip"
    numbers = [s["number"] for s in whole["sessions"] if "laps" in s][1:]
    done = CliRunner().invoke(
        app, ["day", "share", str(folder), "--sessions", ",".join(map(str, numbers)), "--out", str(out)]
    )
    assert done.exit_code == 0, done.exception
    track.unlink()
    shutil.rmtree(folder)
    opened = tmp_path / "there"
    assert CliRunner().invoke(app, ["day", "open", str(out), "--out", str(opened)]).exit_code == 0
    day = read_day(opened)
    same = ("laps", "stops", "remarks", "tyres", "runs", "revisions")
    kept = [s for s in whole["sessions"] if s["number"] in numbers]
    assert [{k: s[k] for k in same} for s in day["sessions"]] == [{k: s[k] for k in same} for s in kept]
    for file in opened.rglob("*.mcap"):
        reader = SessionReader(file)
        content = b"".join(item.data for item in reader.items()) + json.dumps(reader.metadata).encode()
        assert str(tmp_path).encode() not in content
    with ZipFile(out) as archive:
        assert not [name for name in archive.namelist() if name.startswith("/") or ".." in name]


def test_a_copy_says_on_which_track_it_was_driven_before_what_was_driven(tmp_path):
    """Whoever reads on from the beginning would take another track for it, and find no laps."""
    source, copy = write(tmp_path / "one" / "session.mcap", 0.0, 0.01, "A1", "oval"), tmp_path / "copy.mcap"
    recover(source, copy)
    reader = SessionReader(copy)
    next(reader.items())
    assert json.loads(reader.metadata["session"]["config"])["track"] == "oval"


def test_what_is_no_shared_day_is_refused(tmp_path):
    evil = tmp_path / "evil.zip"
    with ZipFile(evil, "w") as archive:
        archive.writestr("../outside.mcap", b"x")
    with pytest.raises(InputError, match="not a shared day"):
        CliRunner().invoke(app, ["day", "open", str(evil), "--out", str(tmp_path / "there")], catch_exceptions=False)
    assert not (tmp_path / "outside.mcap").exists()


def test_a_note_counts_as_taken_when_it_is_in_the_recording(tmp_path: Path) -> None:
    rig = Rig(tmp_path / "s.mcap").run(10)
    assert rig.recorder.status(rig.clock.now_ns()).noted == 0
    rig.bus.publish(NOTE, Note(stamp_ns=1, seq=77, source="t", text="front wing +1"))
    rig.run(1)
    assert rig.recorder.status(rig.clock.now_ns()).noted == 77
    rig.recorder.close(rig.clock.now_ns())
    items = SessionReader(tmp_path / "s.mcap").items()
    assert [item.sequence for item in items if item.topic == NOTE.key] == [77]
