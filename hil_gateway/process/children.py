"""Processes that a command starts to share its work: they end with it, and without a word.

They are started with SIGINT held back, which a terminal sends to all of them at once, until it ends them quietly: while
a new interpreter loads its modules it would be a traceback.
"""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import active_children
from multiprocessing.context import SpawnContext, SpawnProcess


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
