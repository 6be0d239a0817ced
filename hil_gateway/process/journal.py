"""What a process that must be on time says on standard error, written by a thread of its own.

A full disk, a reader that is gone or a terminal that is held (Ctrl-S) costs lines, never a period or the process.
"""

from __future__ import annotations

import logging
import os
from contextlib import suppress
from queue import Full, Queue
from threading import Thread
from types import TracebackType

HELD = 1000
"""lines that wait while standard error takes none"""
LAST_WORDS_S = 1.0
"""for what still waits when the process ends"""
STDERR = 2


class Journal(logging.Handler):
    """Takes every line of the process's log, and those handed to `say`, while its block runs."""

    def __init__(self) -> None:
        super().__init__()
        self._lines: Queue[str | None] = Queue(HELD)
        self._lost = 0
        self._writer = Thread(target=self._write, name="journal", daemon=True)

    def __enter__(self) -> Journal:
        self._writer.start()
        logging.getLogger().addHandler(self)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        logging.getLogger().removeHandler(self)
        with suppress(Full):
            self._lines.put_nowait(None)
            self._writer.join(LAST_WORDS_S)

    def emit(self, record: logging.LogRecord) -> None:
        """A record of the standard log, as one line."""
        self.say(self.format(record))

    def say(self, line: str) -> None:
        """Have a line written when there is time; one that finds no room is counted."""
        note = f" ({self._lost} lines lost before)" if self._lost else ""
        try:
            self._lines.put_nowait(f"{line}{note}\n")
            self._lost = 0
        except Full:
            self._lost += 1

    def _write(self) -> None:
        for line in iter(self._lines.get, None):
            with suppress(OSError):
                os.write(STDERR, line.encode(errors="replace"))
