"""A recorder that is started again writes a new file: one gateway's files are one run, and the gap is named."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from support.cars.session_rig import UNIX_NS
from typer.testing import CliRunner
from unit.hil_gateway.session.test_catalogue import SPEED, estimate

from hil_gateway.bus import messages as m
from hil_gateway.bus.topics import ESTIMATE, GATEWAY_STATUS
from hil_gateway.cli.main import app
from hil_gateway.process.errors import InputError
from hil_gateway.session.files.writer import SessionFile
from hil_gateway.session.run import newest_in, run_of, runs_in
from hil_gateway.track.loading import load_track


def write(path: Path, from_s: float, to_s: float, gateway_began_s: float = 0.0, started: str = "a") -> Path:
    """A car at constant speed on the centre line between two times, with the status of a gateway that began earlier."""
    track = load_track()
    with SessionFile(path, {"session": {"name": "s", "started": started, "config": "{}"}}) as file:
        for i in range(round(10 * from_s), round(10 * to_s)):
            at, now_ns = track.at(SPEED * i / 10), i * 10**8
            messages = {
                ESTIMATE: estimate(now_ns, float(at.x), float(at.y)),
                GATEWAY_STATUS: status(i, gateway_began_s),
            }
            for topic, message in messages.items():
                stamp_ns = UNIX_NS + now_ns
                file.add(topic.key, message.model_dump_json().encode(), stamp_ns, stamp_ns, i)
    return path


def status(i: int, began_s: float) -> m.GatewayStatus:
    return m.GatewayStatus(
        stamp_ns=i * 10**8, seq=max(round(i - 10 * began_s), 0), mode="armed", armed=True, action="drive", cause="",
        missing_for_arming=(), bus="udp", bus_state="error_active", frames_received=0, frames_lost=0, frames_unknown=0,
        frames_malformed=0, counter_errors=0, commands_sent=0, commands_limited=0, loop_latency_p50_ms=None,
        loop_latency_p99_ms=None,
    )  # fmt: skip


def test_the_lap_across_a_restart_of_the_recorder_is_there_with_the_gap_marked(tmp_path):
    lap_s = load_track().length / SPEED
    first = write(tmp_path / "session.mcap", 0.0, 1.5 * lap_s)
    second = write(tmp_path / "session_001.mcap", 1.5 * lap_s + 4.0, 3.2 * lap_s, started="b")
    run = CliRunner()
    for asked in (tmp_path, first):
        info = json.loads(run.invoke(app, ["session", "info", str(asked), "--json"]).stdout)
        assert info["files"] == [str(first), str(second)]
        (gap,) = info["gaps"]
        assert gap["before"] == "session_001.mcap" and gap["seconds"] == pytest.approx(4.1, abs=0.11)
        assert gap["t"] == pytest.approx(90.0, abs=0.11)
        assert [lap["marks"] for lap in info["laps"]] == [["from rest"], ["gap"], []]
        assert [lap["time_s"] for lap in info["laps"]] == pytest.approx([lap_s] * 3, abs=0.1)
        assert info["best_lap_s"] == info["laps"][2]["time_s"]
    said = run.invoke(app, ["session", "info", str(tmp_path)]).output
    assert "goes on in session_001.mcap after 4.1" in said and ", its place unknown" in said
    alone = json.loads(run.invoke(app, ["session", "info", str(second), "--json"]).stdout)
    assert alone["files"] == [str(second)] and len(alone["laps"]) == 1


def test_a_folder_is_every_run_in_it_and_below_it(tmp_path):
    """As a folder of demos is, each in its own."""
    for name, began_s in (("a", 0.0), ("b", 60.0)):
        (tmp_path / name).mkdir()
        write(tmp_path / name / "session.mcap", began_s, began_s + 2.0, gateway_began_s=began_s, started=name)
    infos = json.loads(CliRunner().invoke(app, ["session", "info", str(tmp_path), "--json"]).stdout)["sessions"]
    assert [info["files"] for info in infos] == [[str(tmp_path / name / "session.mcap")] for name in ("a", "b")]


def test_another_gateway_is_another_run(tmp_path):
    first = write(tmp_path / "session.mcap", 0.0, 5.0)
    again = write(tmp_path / "session_001.mcap", 60.0, 65.0, gateway_began_s=58.0, started="b")
    assert runs_in([again, first]) == [(first,), (again,)]
    assert run_of(first) == (first,)


def test_a_file_that_cannot_be_read_is_a_run_of_its_own(tmp_path):
    first, bad = write(tmp_path / "session.mcap", 0.0, 5.0), tmp_path / "bad.mcap"
    bad.write_bytes(b"no recording")
    assert runs_in([bad, first]) == [(first,), (bad,)]


def test_the_newest_recording_of_a_folder_of_folders_is_the_one_to_look_at(tmp_path):
    for name, written_ns in (("a", 2), ("b", 1)):
        (tmp_path / name).mkdir()
        path = write(tmp_path / name / "session.mcap", 0.0, 1.0)
        os.utime(path, ns=(written_ns, written_ns))
    assert newest_in(tmp_path) == tmp_path / "a" / "session.mcap"
    empty = tmp_path / "b" / "empty"
    empty.mkdir()
    with pytest.raises(InputError, match="no recording"):
        newest_in(empty)
