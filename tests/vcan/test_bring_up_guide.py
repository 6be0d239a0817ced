"""The bring-up guide, followed literally: its bench commands are typed into one shell, what it promises must appear.

HIL_GUIDE=all also types the blocks that drive the car, for which this machine must be fast enough.
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

import pytest
from support.promise_figures import long_run

pytestmark = [
    pytest.mark.vcan,
    pytest.mark.slow,
    pytest.mark.skipif(
        os.environ.get("HIL_VCAN_KIND") == "user-mode Linux" and not long_run(),
        reason="takes four to six minutes in user-mode Linux: HIL_LONG=1",
    ),
]
ROOT = Path(__file__).resolve().parents[2]
GUIDE = ROOT / "docs" / "bring-up.md"
KINDS = ("", " slow") if os.environ.get("HIL_GUIDE") == "all" else ("",)
MARK = "@@@ exit"
GATEWAY_LOG = re.compile(r"hil gateway run 2>(\S+)")
PATIENCE_S = 180.0
"""How long a command is repeated until it shows what the guide says."""


@dataclass
class Step:
    """One typed command, the parts of its output the guide shows, and the exit code it names."""

    command: str
    parts: list[str] = field(default_factory=list)
    code: int = 0

    @property
    def in_background(self) -> bool:
        return self.command.endswith("&")

    def shown_by(self, output: str) -> bool:
        """Whether all parts and the exit code are there, spaces aside."""
        text = " ".join(output.split())
        exit_as_said = self.in_background or f"{MARK} {self.code}" in text
        return exit_as_said and all(" ".join(part.split()) in text for part in self.parts)


def steps() -> list[Step]:
    found: list[Step] = []
    for kind, block in re.findall(r"^```console(.*?)\n(.*?)^```", GUIDE.read_text(), re.DOTALL | re.MULTILINE):
        for line in block.splitlines() if kind in KINDS else ():
            if line.startswith("$ "):
                found.append(Step(line.removeprefix("$ ")))
            elif match := re.fullmatch(r"\[exit (\d+)\]", line):
                found[-1].code = int(match[1])
            else:
                found[-1].parts.append(line)
    return found


class Shell:
    """A shell somebody types into."""

    def __init__(self, folder: Path) -> None:
        self._screen = folder / "screen"
        with self._screen.open("wb") as output:
            self._shell = subprocess.Popen(
                ["bash"], cwd=folder, stdin=subprocess.PIPE, stdout=output, stderr=subprocess.STDOUT,
                text=True, start_new_session=True,
            )  # fmt: skip
        assert self._shell.stdin is not None
        self._keyboard: IO[str] = self._shell.stdin

    def type(self, command: str) -> str:
        """What appears until the command has ended."""
        start = self._screen.stat().st_size
        self._keyboard.write(f"{command}\necho '{MARK}' $?\n")
        self._keyboard.flush()
        end = time.monotonic() + PATIENCE_S
        while MARK not in (output := self._screen.read_bytes()[start:].decode()) and time.monotonic() < end:
            time.sleep(0.05)
        return output

    def wait_for(self, log: Path) -> None:
        """Until a process in the background has logged something: a gateway does when it hears the car."""
        end = time.monotonic() + PATIENCE_S
        while not (log.exists() and log.stat().st_size) and time.monotonic() < end:
            time.sleep(0.1)

    def close(self) -> None:
        with suppress(ProcessLookupError):
            os.killpg(self._shell.pid, signal.SIGKILL)  # with all it started
        self._shell.wait()
        self._keyboard.close()


@contextmanager
def shell(folder: Path) -> Iterator[Shell]:
    opened = Shell(folder)
    try:
        yield opened
    finally:
        opened.close()
        subprocess.run(["ip", "link", "del", "vcan1"], check=False, capture_output=True)


def test_every_step_of_the_bench_shows_what_the_guide_says(channel: str, tmp_path: Path) -> None:
    """`channel` only makes sure that there is SocketCAN; the guide makes its own interface."""
    guide = steps()
    assert len(guide) > 15
    (tmp_path / ".venv").symlink_to(ROOT / ".venv")
    with shell(tmp_path) as bench:
        for step in guide:
            output, end = bench.type(step.command), time.monotonic() + PATIENCE_S
            if log := GATEWAY_LOG.search(step.command):  # asked before it runs, it costs three questions
                bench.wait_for(tmp_path / log[1])
            while not step.shown_by(output) and not step.in_background and time.monotonic() < end:
                time.sleep(1.0)
                output = bench.type(step.command)
            logs = "".join(f"\n== {log.name}\n{log.read_text()[-800:]}" for log in tmp_path.glob("*.log"))
            assert step.shown_by(output), f"{step.command!r} does not show {step.parts} but\n{output}{logs}"
