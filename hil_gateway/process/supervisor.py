"""Starts and stops the processes of the loop from one table, and says which died."""

from __future__ import annotations

import contextlib
import os
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from hil_gateway.process.lifecycle import EVENT_LINE, PARENT_VARIABLE
from hil_gateway.process.scheduling import PRIORITIES, real_time

CLOCK_TICKS = os.sysconf("SC_CLK_TCK")
NICENESS = -10
STOP_S = 1.0
"""what the drivers of the loop get to end in order; the recorder, asked last, gets the same again"""


@dataclass(frozen=True)
class ProcessSpec:
    """One process of the loop: `hil <name> run --config FILE`.

    Stage 0 starts first, the rest when the recorder listens, so that a recording begins before what it records.
    `stops_last`: it has the end of the others to hear. Losing an `optional` one is no reason to end. `low_priority`:
    it gives way to all of them. `waits`: asked once it ends in its own time, asked twice at once.
    `arguments`: of this process alone.
    """

    name: str
    stage: int = 1
    stops_last: bool = False
    optional: bool = False
    low_priority: bool = False
    waits: bool = False
    arguments: tuple[str, ...] = ()


PROCESSES: tuple[ProcessSpec, ...] = (
    ProcessSpec("gateway", stage=0, waits=True),
    ProcessSpec("recorder", stage=0, stops_last=True),
    ProcessSpec("plant"),
    ProcessSpec("estimator"),
    ProcessSpec("planner"),
)
DASHBOARD = ProcessSpec("dashboard", optional=True)
RECEIVER = ProcessSpec("receiver")
LEARNER = ProcessSpec("learner", optional=True, low_priority=True)


@dataclass(frozen=True)
class Exit:
    """A process that ended without being asked to."""

    name: str
    code: int
    last_words: str
    again: str
    """what a person types to start it again"""
    optional: bool = False

    def __str__(self) -> str:
        how = (
            f"was killed by {signal.Signals(-self.code).name}" if self.code < 0 else f"ended with exit code {self.code}"
        )
        said = "; it had said: " if self.code < 0 else ": "
        return f"{self.name} {how}" + (f"{said}{self.last_words}" if self.last_words else "")


class Supervisor:
    """The running processes. Each has its own process group, so that Ctrl-C reaches only the parent, and gets
    SIGTERM when the parent dies in any way. Their standard error goes to `folder`/NAME.log."""

    def __init__(self, config_file: Path, folder: Path, specs: Sequence[ProcessSpec] = PROCESSES) -> None:
        self._config_file, self._folder, self._specs = config_file, folder, specs
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        self._cpu_s: dict[str, float] = {}
        self._asked: set[str] = set()
        """processes that end because they were asked to"""

    def __enter__(self) -> Supervisor:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    @property
    def pids(self) -> dict[str, int]:
        """Process identifier of everything that still runs."""
        return {name: process.pid for name, process in self._running.items()}

    def start(self, stage: int) -> None:
        """Start the processes of one stage."""
        self._folder.mkdir(parents=True, exist_ok=True)
        for spec in (s for s in self._specs if s.stage == stage):
            with self._log(spec.name).open("wb") as log:
                self._running[spec.name] = subprocess.Popen(
                    self.command(spec), stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True,
                    env={**os.environ, PARENT_VARIABLE: str(os.getpid())},
                )  # fmt: skip
            if not spec.low_priority:
                _prefer(self._running[spec.name].pid)

    def prefer_real_time(self) -> None:
        """Let the processes that drive come before everything else, where the user may ask for that (root may).

        Whatever they start later, a compiler for instance, runs as ordinary work again.
        """
        for spec in self._specs:
            if spec.name in PRIORITIES and spec.name in self._running:
                real_time(spec.name, self._running[spec.name].pid)

    def command(self, spec: ProcessSpec) -> list[str]:
        """What is run for a process."""
        return [sys.executable, "-m", "hil_gateway", *self._arguments(spec)]

    def _arguments(self, spec: ProcessSpec) -> list[str]:
        return [spec.name, "run", "--config", str(self._config_file), *spec.arguments]

    def poll(self) -> list[Exit]:
        """Processes that ended since the last call."""
        ended = [s for s in self._specs if s.name in self._running and self._running[s.name].poll() is not None]
        codes = {spec: self._running.pop(spec.name).returncode for spec in ended}
        unasked = [spec for spec in ended if spec.name not in self._asked]
        return [Exit(s.name, codes[s], self._last_words(s.name), self._again(s), s.optional) for s in unasked]

    def _again(self, spec: ProcessSpec) -> str:
        return shlex.join(["hil", *self._arguments(spec)])

    def ask_to_end(self, name: str) -> None:
        """Ask one process to end in its own time, and go on; `poll` does not report it."""
        if name in self._running:
            self._asked.add(name)
            self._running[name].terminate()

    def cpu_seconds(self) -> dict[str, float]:
        """Processor time each process has used so far (its last known value once it has ended)."""
        for name, pid in self.pids.items():
            if (used := _cpu_seconds(pid)) is not None:
                self._cpu_s[name] = used
        return dict(self._cpu_s)

    def stop(self) -> None:
        """End everything in at most twice `STOP_S`; what does not end by itself is killed."""
        for last in (False, True):
            self._end([s for s in self._specs if s.stops_last == last and s.name in self._running])

    def _end(self, specs: Sequence[ProcessSpec]) -> None:
        for spec in specs:
            if spec.waits:  # another signal than the next one: two of a kind may arrive as one
                self._running[spec.name].send_signal(signal.SIGINT)
            self._running[spec.name].terminate()
        deadline = time.monotonic() + STOP_S
        for spec in specs:
            process = self._running.pop(spec.name)
            try:
                process.wait(max(deadline - time.monotonic(), 0.0))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def _log(self, name: str) -> Path:
        return self._folder / f"{name}.log"

    def _last_words(self, name: str) -> str:
        text = self._log(name).read_text(errors="replace").strip()
        lines = [line for line in text.splitlines() if not line.startswith(EVENT_LINE)]
        return lines[-1].removeprefix("hil: ") if lines else ""


def _prefer(pid: int) -> None:
    """Ahead of ordinary work on this computer, where the user may ask for that (root may).

    Where the kernel groups tasks by session (sched(7), autogroup), it is the group that has to be preferred.
    """
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, pid, NICENESS)
        Path(f"/proc/{pid}/autogroup").write_text(str(NICENESS))


def _cpu_seconds(pid: int) -> float | None:
    """User and system time of a process, from proc(5) stat fields 14 and 15; None when it is gone."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return None
    return (int(fields[11]) + int(fields[12])) / CLOCK_TICKS
