"""The demo as a user runs it: real processes over CAN and Zenoh, one of which dies, or the user has had enough.

HIL_LONG=1 kills every process of the table; otherwise the gateway, without which nobody commands. tests/faults has the
others, in the running loop.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from support.promise_figures import long_run, record_figure

from hil_gateway.bus.topics import TRUTH
from hil_gateway.can_link import resolve_kind
from hil_gateway.car.car import load_car
from hil_gateway.config import load_config
from hil_gateway.process.supervisor import PROCESSES
from hil_gateway.session.files.format import unpack_message
from hil_gateway.session.files.reader import SessionReader
from hil_gateway.session.overview.info import session_info

pytestmark = pytest.mark.quiet
Recorder = Callable[[str, object], None]
UP_S = 120.0
VICTIMS = tuple(p.name for p in PROCESSES) if long_run() else ("gateway",)


class Demo:
    """`hil demo` in a process of its own."""

    def __init__(self, folder: Path, record_property: Recorder) -> None:
        record_property("can", resolve_kind(load_config().can))
        self.folder, self.said = folder, ""
        command = [sys.executable, "-m", "hil_gateway", "demo", "--seconds", "120", "--headless", "--json"]
        self.process = subprocess.Popen(
            [*command, "--out", str(folder)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )

    def __enter__(self) -> Demo:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.communicate()

    def wait_under_way(self) -> None:
        """Until the car drives by itself."""
        assert self.process.stderr is not None
        deadline = time.monotonic() + UP_S
        while "under way" not in self.said:
            line = self.process.stderr.readline()
            self.said += line
            assert line, f"the demo ended early: {self.said}"
            assert time.monotonic() < deadline, self.said

    def pid_of(self, name: str) -> int:
        """Process identifier of one of its processes."""
        for entry in Path("/proc").glob("[0-9]*/cmdline"):
            try:
                words = entry.read_bytes().decode().split("\0")
            except OSError:
                continue
            if name in words and str(self.folder / "config.toml") in words:
                return int(entry.parent.name)
        raise AssertionError(f"{name} does not run")

    def result(self, timeout_s: float) -> dict[str, Any]:
        """Its summary, once it has ended."""
        out, err = self.process.communicate(timeout=timeout_s)
        self.said += err
        summary: dict[str, Any] = json.loads(out)
        return summary


@pytest.mark.slow
@pytest.mark.promise("L6")
@pytest.mark.parametrize("victim", VICTIMS)
def test_losing_any_process_ends_in_a_stop_and_the_demo_says_so(
    victim: str, tmp_path: Path, record_property: Recorder
) -> None:
    with Demo(tmp_path / "out", record_property) as demo:
        demo.wait_under_way()
        time.sleep(1.5)  # at speed
        os.kill(demo.pid_of(victim), signal.SIGKILL)
        summary = demo.result(timeout_s=40)
    assert demo.process.returncode == 1
    assert summary["ending"] == "process died"
    assert any(f"{victim} was killed by SIGKILL" in event["text"] for event in summary["events"])
    assert any("m/s" in event["text"] or "plant is gone" in event["text"] for event in summary["events"])
    if victim not in ("gateway", "plant"):
        assert summary["failsafes"][0]["action"] in ("controlled_stop", "emergency_stop")
    if victim != "plant":
        assert "the car is at 0." in " ".join(event["text"] for event in summary["events"])
    info = session_info(tmp_path / "out" / "session.mcap", car=load_car())
    assert info["complete"] == (victim != "recorder")
    assert info["topics"]["av24/can"]["messages"] > 1000
    record_figure("L6", f"{victim} killed in a running demo: {summary['events'][-1]['text']}")


@pytest.mark.slow
@pytest.mark.long
def test_ctrl_c_ends_everything_within_3_s_with_a_readable_recording(tmp_path: Path, record_property: Recorder) -> None:
    with Demo(tmp_path / "out", record_property) as demo:
        demo.wait_under_way()  # and at once: where the machine is late, the gateway stops the car and the demo ends
        pids = [demo.pid_of(p.name) for p in PROCESSES]
        begin = time.monotonic()
        demo.process.send_signal(signal.SIGINT)
        summary = demo.result(timeout_s=10)
        took_s = time.monotonic() - begin
    assert took_s < 3.0
    assert summary["ending"] == "interrupted"
    assert demo.process.returncode == 130
    assert not any(Path(f"/proc/{pid}").exists() for pid in pids)
    info = session_info(tmp_path / "out" / "session.mcap", car=load_car())
    assert info["complete"]
    assert not info["damage"]


@pytest.mark.slow
def test_ctrl_c_at_speed_stops_the_car_on_the_road_before_all_ends_with_a_readable_recording(
    tmp_path: Path, record_property: Recorder
) -> None:
    with Demo(tmp_path / "out", record_property) as demo:
        demo.wait_under_way()
        pids = [demo.pid_of(p.name) for p in PROCESSES]
        time.sleep(5.0)  # 20 m/s
        demo.process.send_signal(signal.SIGINT)
        summary = demo.result(timeout_s=25)
    assert demo.process.returncode == 130
    assert summary["ending"] == "interrupted"
    assert [stop["cause"] for stop in summary["failsafes"]] == ["gateway_ending"]
    assert summary["off_track"] == 0
    assert not any(Path(f"/proc/{pid}").exists() for pid in pids)
    info = session_info(tmp_path / "out" / "session.mcap", car=load_car())
    assert info["complete"]
    assert not info["damage"]
    *_, last = SessionReader(tmp_path / "out" / "session.mcap", frozenset({TRUTH.key})).items()
    assert abs(unpack_message(TRUTH, last.data).vx) < 1.0
