"""A folder of sessions: each file is read once, and again only when it has changed; laps and stops are in the list."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from support.cars.session_rig import UNIX_NS, recorded
from typer.testing import CliRunner

from hil_gateway.bus import messages as m
from hil_gateway.bus.event import Event, EventKind, Severity
from hil_gateway.bus.topics import ESTIMATE, EVENT, MODEL_REVISION
from hil_gateway.car.car import load_car
from hil_gateway.cli.main import app
from hil_gateway.session.files.writer import SessionFile
from hil_gateway.session.overview import catalogue as module
from hil_gateway.session.overview.catalogue import INDEX, catalogue
from hil_gateway.session.overview.info import session_info
from hil_gateway.session.overview.summary import session_summary
from hil_gateway.track.loading import load_track

SPEED = 60.0


def write_drive(path: Path, laps: float = 2.2, started: str = "2026-01-02T03:04:05Z") -> Path:
    """A car on the centre line of the road course at constant speed, stopped by the gateway at the end."""
    track = load_track()
    metadata = {"session": {"started": started, "software": "1.0", "config": "{}"}}
    with SessionFile(path, metadata) as file:

        def add(topic, message):
            stamp_ns = UNIX_NS + message.stamp_ns
            file.add(topic.key, message.model_dump_json().encode(), stamp_ns, stamp_ns, message.seq)

        steps = round(laps * track.length / SPEED * 10)
        for i in range(steps):
            at = track.at(SPEED * i / 10)
            add(ESTIMATE, estimate(i * 10**8, float(at.x), float(at.y)))
        effect = m.ActiveEffect(name="aero_drag", parameters={"c": 1.2})
        revision = m.ModelRevision(stamp_ns=1, seq=0, revision="r1", layout="shared", tyre={"cx": 1}, effects=(effect,))
        add(MODEL_REVISION, revision)
        add(EVENT, stop(steps * 10**8))
    return path


def estimate(now_ns: int, x: float, y: float) -> m.Estimate:
    return m.Estimate(
        stamp_ns=now_ns, seq=1, state_stamp_ns=now_ns, valid=True, x=x, y=y, yaw=0, vx=SPEED, vy=0, yaw_rate=0,
        bias_ax=0, bias_ay=0, bias_yaw_rate=0, std=(0.1,) * 9, steer=0, drive=0, innovations_rejected=0,
    )  # fmt: skip


def stop(now_ns: int) -> Event:
    return Event(
        stamp_ns=now_ns, seq=0, kind=EventKind.FAILSAFE, severity=Severity.STOP, before="drive",
        after="controlled_stop", cause="command_stale", measured=0.11, limit=0.1, unit="s", text="no fresh command",
    )  # fmt: skip


def test_a_session_s_laps_stops_and_effects_are_in_its_summary(tmp_path):
    summary = session_summary(write_drive(tmp_path / "a.mcap"))
    whole = load_track().length / SPEED
    assert [lap["time_s"] for lap in summary["laps"]] == pytest.approx([whole, whole], abs=0.05)
    assert [(s["cause"], s["measured"], s["limit"]) for s in summary["stops"]] == [("command_stale", 0.11, 0.1)]
    assert summary["effects"] == ["aero_drag"]


def test_session_info_says_laps_and_stops(tmp_path):
    path = write_drive(tmp_path / "a.mcap")
    assert session_info(path, car=load_car())["stops"][0]["cause"] == "command_stale"
    said = CliRunner().invoke(app, ["session", "info", str(path)]).output
    assert "lap 2: " in said and "command_stale (0.11 s, limit 0.1 s)" in said


def test_a_folder_is_read_once_and_only_what_changed_is_read_again(tmp_path, monkeypatch):
    first = write_drive(tmp_path / "first.mcap")
    for i in range(1, 1000):
        (tmp_path / f"copy{i}.mcap").hardlink_to(first)
    write_drive(tmp_path / "sub.mcap", 0.1, started="2026-01-03T00:00:00Z")
    entry = module._entry(first)
    with monkeypatch.context() as patched:
        patched.setattr(module, "_entry", lambda path: entry)
        assert catalogue(tmp_path).read == 1001

    def refuse(path):
        raise AssertionError(f"{path} was read again")

    with monkeypatch.context() as patched:
        patched.setattr(module, "_entry", refuse)
        found = catalogue(tmp_path)
    assert (len(found.entries), found.read) == (1001, 0)
    os.utime(tmp_path / "sub.mcap", ns=(1, 1))
    again = catalogue(tmp_path)
    assert again.read == 1 and again.entries[-1]["file"] == "sub.mcap"


def test_who_interrupts_the_first_call_does_not_begin_anew(tmp_path, monkeypatch):
    for name in "abcd":
        recorded(tmp_path / f"{name}.mcap")
    read = module._entry

    def interrupted_at_the_last(path: Path):
        if path.name == "d.mcap":
            raise KeyboardInterrupt
        return read(path)

    with monkeypatch.context() as patched:
        patched.setattr(module, "STORED_EVERY", 1)
        patched.setattr(module, "_entry", interrupted_at_the_last)
        with pytest.raises(KeyboardInterrupt):
            catalogue(tmp_path)
    assert catalogue(tmp_path).read == 1


def test_what_is_no_session_is_named_and_a_broken_index_is_made_anew(tmp_path):
    write_drive(tmp_path / "good.mcap", 0.1)
    (tmp_path / "bad.mcap").write_bytes(b"no recording")
    (tmp_path / INDEX).write_text('{"version": 1, "entries": {"good.mcap": 3}}')
    found = {row["file"]: row for row in catalogue(tmp_path).entries}
    assert "not an MCAP recording" in found["bad.mcap"]["unreadable"]
    assert found["good.mcap"]["stops"] == ["command_stale"]


def test_a_recording_without_any_topic_of_ours_has_no_laps_and_no_stops(tmp_path):
    recorded(tmp_path / "raw.mcap")
    summary = session_summary(tmp_path / "raw.mcap")
    assert summary["laps"] == summary["stops"] == []


def test_list_prints_a_line_a_session_and_json(tmp_path):
    write_drive(tmp_path / "a.mcap")
    run = CliRunner()
    assert "stops: 1 (command_stale)" in run.invoke(app, ["session", "list", str(tmp_path)]).output
    (row,) = json.loads(run.invoke(app, ["session", "list", str(tmp_path), "--json"]).stdout)["sessions"]
    assert row["laps"] == 2 and row["effects"] == ["aero_drag"]


def test_a_lap_from_rest_is_timed_from_its_first_metres_on_in_which_the_heading_is_not_known(tmp_path: Path) -> None:
    track, path = load_track(), tmp_path / "session.mcap"
    with SessionFile(path, {"session": {"started": "", "software": "1.0", "config": "{}"}}) as file:
        for i in range(round(1.1 * track.length / SPEED * 10)):
            at = track.at(SPEED * i / 10)
            known = {"valid": i > 5, "lacks": "" if i > 5 else "heading"}
            message = estimate(i * 10**8, float(at.x), float(at.y)).model_copy(update=known)
            stamp_ns = UNIX_NS + message.stamp_ns
            file.add(ESTIMATE.key, message.model_dump_json().encode(), stamp_ns, stamp_ns, i)
    (lap,) = session_summary(path)["laps"]
    assert lap["from_rest"] and lap["time_s"] == pytest.approx(track.length / SPEED, abs=0.01)
