"""Work in a child process that gives way to whoever drives, with an end to its time and memory."""

from __future__ import annotations

import os
import resource
import time
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any, Protocol

from hil_gateway.process.children import Spawn, begin
from hil_gateway.process.errors import InputError
from hil_gateway.process.lifecycle import PARENT_VARIABLE, end_with_parent

NICENESS = 19
MOST_S = 480.0
"""a diagnosis of four laps takes two to four minutes of one processor that others use as well"""
MOST_BYTES = 2 << 30
"""of data; four laps need 0.4 GB"""


@dataclass(frozen=True)
class Failed:
    """Why there is no result."""

    reason: str


class Running(Protocol):
    """Work under way."""

    def poll(self) -> Any | Failed | None:
        """Its result or why there is none, once; None while it goes on."""
        ...

    def stop(self) -> None:
        """End it, whatever it has come to."""
        ...


class ChildJob:
    """`work(argument)` in a process of its own."""

    def __init__(self, work: Callable[[Any], Any], argument: Any, most_s: float = MOST_S) -> None:
        spawn = Spawn()
        self._results, there = spawn.Pipe(duplex=False)
        arguments = (there, os.getpid(), work, argument)
        self._process = spawn.Process(target=_work, args=arguments, daemon=True)
        self._process.start()
        there.close()
        self._most_s, self._ends_s = most_s, time.monotonic() + most_s

    def poll(self) -> Any | Failed | None:
        """See `Running.poll`."""
        if self._results.poll():
            return self._received()
        if time.monotonic() > self._ends_s:
            self.stop()
            return Failed(f"not done within {self._most_s:.0f} s")
        return None

    def stop(self) -> None:
        """See `Running.stop`."""
        self._process.kill()
        self._process.join()

    def _received(self) -> Any | Failed:
        try:
            result = self._results.recv()
        except EOFError:
            result = Failed("the process that did it ended early (out of memory, or killed)")
        self._process.join()
        return result


def _work(results: Connection, parent: int, work: Callable[[Any], Any], argument: Any) -> None:
    """The child: last in line for processors, one of them at most, and no more memory than `MOST_BYTES`."""
    begin()
    os.environ[PARENT_VARIABLE] = str(parent)
    end_with_parent()
    os.setpriority(os.PRIO_PROCESS, 0, NICENESS)
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    resource.setrlimit(resource.RLIMIT_DATA, (MOST_BYTES, MOST_BYTES))
    try:
        results.send(work(argument))
    except InputError as error:
        results.send(Failed(str(error)))
    except MemoryError:
        results.send(Failed(f"more than {MOST_BYTES >> 20} MB would be needed"))
