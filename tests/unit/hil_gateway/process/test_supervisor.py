"""Processes are started, watched and ended from one table."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from hil_gateway.process.supervisor import ProcessSpec, Supervisor

SLEEP = "import time; print('up', flush=True); time.sleep(60)"
STUBBORN = "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); print('up', flush=True); time.sleep(60)"
ORDERLY = (
    "import signal, sys, time\n"
    "signal.signal(signal.SIGTERM, lambda *_: (print(time.monotonic_ns()), sys.exit(0)))\n"
    "print('up', flush=True)\n"
    "time.sleep(60)"
)


class Scripts(Supervisor):
    """Runs Python snippets instead of the commands of the project."""

    def __init__(self, folder: Path, scripts: dict[str, str], specs: tuple[ProcessSpec, ...] = ()) -> None:
        super().__init__(folder / "config.toml", folder, specs or tuple(ProcessSpec(name) for name in scripts))
        self._scripts = scripts
        self.folder = folder

    def command(self, spec: ProcessSpec) -> list[str]:
        return [sys.executable, "-c", self._scripts[spec.name]]

    def wait_up(self) -> None:
        deadline = time.monotonic() + 20
        while not all("up" in (self.folder / f"{name}.log").read_text() for name in self.pids):
            assert time.monotonic() < deadline
            time.sleep(0.02)


def test_a_killed_process_is_named_with_its_signal_once(tmp_path: Path) -> None:
    with Scripts(tmp_path, {"planner": SLEEP, "plant": SLEEP}) as supervisor:
        supervisor.start(1)
        supervisor.wait_up()
        os.kill(supervisor.pids["planner"], signal.SIGKILL)
        deadline = time.monotonic() + 5
        while not (gone := supervisor.poll()):
            assert time.monotonic() < deadline
        assert [str(e) for e in gone] == ["planner was killed by SIGKILL; it had said: up"]
        assert gone[0].again == f"hil planner run --config {tmp_path}/config.toml"
        assert supervisor.poll() == []
        assert list(supervisor.pids) == ["plant"]


def test_a_failing_process_is_quoted_with_its_last_words(tmp_path: Path) -> None:
    with Scripts(tmp_path, {"gateway": "raise SystemExit('hil: port 7 is busy')"}) as supervisor:
        supervisor.start(1)
        deadline = time.monotonic() + 20
        while not (gone := supervisor.poll()):
            assert time.monotonic() < deadline
        assert str(gone[0]) == "gateway ended with exit code 1: port 7 is busy"


def test_stopping_ends_even_a_process_that_ignores_it_within_3_s(tmp_path: Path) -> None:
    supervisor = Scripts(tmp_path, {"plant": STUBBORN, "planner": SLEEP})
    supervisor.start(1)
    supervisor.wait_up()
    pids = list(supervisor.pids.values())
    begin = time.monotonic()
    supervisor.stop()
    assert time.monotonic() - begin < 3.0
    assert not any(Path(f"/proc/{pid}").exists() for pid in pids)


def test_the_recorder_is_asked_last(tmp_path: Path) -> None:
    specs = (ProcessSpec("recorder", stops_last=True), ProcessSpec("plant"))
    supervisor = Scripts(tmp_path, {"recorder": ORDERLY, "plant": ORDERLY}, specs)
    supervisor.start(1)
    supervisor.wait_up()
    supervisor.stop()
    ended = {name: int((tmp_path / f"{name}.log").read_text().split()[-1]) for name in ("recorder", "plant")}
    assert ended["recorder"] > ended["plant"]


def test_who_would_take_its_time_is_asked_twice_in_the_end(tmp_path: Path) -> None:
    patient = (
        "import signal, sys\n"
        "signals = {signal.SIGINT, signal.SIGTERM}\n"
        "signal.pthread_sigmask(signal.SIG_BLOCK, signals)\n"
        "print('up', flush=True)\n"
        "print([signal.sigwait(signals) for _ in signals])"
    )
    supervisor = Scripts(tmp_path, {"gateway": patient}, (ProcessSpec("gateway", waits=True),))
    supervisor.start(1)
    supervisor.wait_up()
    supervisor.stop()
    said = (tmp_path / "gateway.log").read_text()
    assert "SIGINT" in said and "SIGTERM" in said


def test_a_process_that_was_asked_to_end_goes_without_a_report(tmp_path: Path) -> None:
    with Scripts(tmp_path, {"gateway": ORDERLY, "plant": SLEEP}) as supervisor:
        supervisor.start(1)
        supervisor.wait_up()
        supervisor.ask_to_end("gateway")
        deadline = time.monotonic() + 5
        while "gateway" in supervisor.pids:
            assert supervisor.poll() == []
            assert time.monotonic() < deadline
        assert list(supervisor.pids) == ["plant"]
        supervisor.ask_to_end("gateway")  # gone: nothing to ask


def test_stages_start_when_told(tmp_path: Path) -> None:
    specs = (ProcessSpec("gateway", stage=0), ProcessSpec("plant", stage=1))
    with Scripts(tmp_path, {"gateway": SLEEP, "plant": SLEEP}, specs) as supervisor:
        supervisor.start(0)
        assert list(supervisor.pids) == ["gateway"]
        supervisor.start(1)
        assert list(supervisor.pids) == ["gateway", "plant"]


def test_processor_time_is_measured_per_process(tmp_path: Path) -> None:
    busy = "print('up', flush=True)\nwhile True: pass"
    with Scripts(tmp_path, {"busy": busy, "idle": SLEEP}) as supervisor:
        supervisor.start(1)
        supervisor.wait_up()
        before = supervisor.cpu_seconds()
        time.sleep(1.0)
        after = supervisor.cpu_seconds()
        assert after["busy"] - before["busy"] > 0.1
        assert after["idle"] - before["idle"] < 0.1


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may ask for real-time priority")
def test_only_what_drives_gets_real_time_priority(tmp_path: Path) -> None:
    specs = (ProcessSpec("gateway"), ProcessSpec("recorder"))
    with Scripts(tmp_path, {"gateway": SLEEP, "recorder": SLEEP}, specs) as supervisor:
        supervisor.start(1)
        supervisor.wait_up()
        supervisor.prefer_real_time()
        policy = {name: os.sched_getscheduler(pid) & ~os.SCHED_RESET_ON_FORK for name, pid in supervisor.pids.items()}
    assert policy == {"gateway": os.SCHED_RR, "recorder": os.SCHED_OTHER}


def test_no_orphan_survives_a_killed_supervisor(tmp_path: Path) -> None:
    """The child is the project's own command line, which asks the kernel to be told of its parent's death."""
    parent = (
        "import sys, time\n"
        "from pathlib import Path\n"
        "from hil_gateway.process.supervisor import ProcessSpec, Supervisor\n"
        "class S(Supervisor):\n"
        "    def command(self, spec):\n"
        "        module = 'hil_gateway.process.lifecycle'\n"
        "        code = f'from {module} import end_with_parent as e; e(); import time; time.sleep(60)'\n"
        "        return [sys.executable, '-c', code]\n"
        f"s = S(Path('x'), Path({str(tmp_path)!r}), (ProcessSpec('plant'),))\n"
        "s.start(1)\n"
        "print(s.pids['plant'], flush=True)\n"
        "time.sleep(60)\n"
    )
    with subprocess.Popen([sys.executable, "-c", parent], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        child = int(process.stdout.readline())
        time.sleep(1.0)
        process.kill()
    deadline = time.monotonic() + 5
    while _runs(child):
        assert time.monotonic() < deadline, "the child outlived its supervisor"
        time.sleep(0.02)


def _runs(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
