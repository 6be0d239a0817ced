"""Processes that a command starts: some share its work, and end with it and without a word; one is another command of
the project, the seam over which a package uses one that it may not import.

Those that share are started with SIGINT held back, which a terminal sends to all of them at once, until it ends them
quietly: while a new interpreter loads its modules it would be a traceback.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import active_children
from multiprocessing.context import SpawnContext, SpawnProcess
from typing import Any

TIMEOUT_S = 3600.0
"""of another command: of a recording of hours"""


class _Process(SpawnProcess):
    def start(self) -> None:
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            super().start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


class Spawn(SpawnContext):
    """Starts processes from nothing: a fork would copy locks of the threads that draw a bar or run BLAS."""

    Process = _Process


def begin() -> None:
    """First thing in a process that was started by `Spawn`."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


@contextmanager
def pool(count: int, initializer: Callable[[], None] = begin) -> Iterator[ProcessPoolExecutor]:
    """So many processes for tasks; what is under way is given up when the block ends by an exception."""
    with ProcessPoolExecutor(count, Spawn(), initializer=initializer) as executor:
        try:
            yield executor
        except BaseException:
            for child in active_children():
                child.terminate()
            raise


@dataclass(frozen=True)
class CommandResult:
    """What a command of the project said: its JSON, or why there is none."""

    content: dict[str, Any]
    reason: str = ""


def ask(arguments: Sequence[str]) -> CommandResult:
    """Run `hil ARGUMENTS --json`; a failure becomes a reason. On a terminal its progress shows."""
    command = [sys.executable, "-m", "hil_gateway", *arguments, "--json"]
    try:
        stderr = None if sys.stderr.isatty() else subprocess.PIPE
        done = subprocess.run(command, stdout=subprocess.PIPE, stderr=stderr, text=True, timeout=TIMEOUT_S, check=False)
    except subprocess.TimeoutExpired:
        return CommandResult({}, f"`hil {arguments[0]}` took longer than {TIMEOUT_S:g} s")
    if done.returncode != 0:
        lines = (done.stderr or "").strip().splitlines()
        return CommandResult({}, lines[-1].removeprefix("hil: ") if lines else f"`hil {arguments[0]}` failed")
    return CommandResult(json.loads(done.stdout))
