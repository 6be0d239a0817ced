"""What every process of the loop does the same way: end in order when asked to."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable


def stop_requested() -> Callable[[], bool]:
    """Install handlers for SIGINT and SIGTERM; the result says whether one has arrived."""
    event = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: event.set())
    return event.is_set
