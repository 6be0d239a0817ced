"""What every process of the loop does the same way: end in order when asked to."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable

PARENT_VARIABLE = "HIL_PARENT"
"""environment variable with the process identifier of the supervisor, in the processes it starts"""
PR_SET_PDEATHSIG = 1


def stop_requested() -> Callable[[], bool]:
    """Install handlers for SIGINT and SIGTERM; the result says whether one has arrived."""
    event = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: event.set())
    return event.is_set


def end_with_parent() -> None:
    """Have the kernel send SIGTERM when the supervisor dies in any way: no orphan drives on."""
    parent = os.environ.get(PARENT_VARIABLE)
    if parent is None:
        return
    import ctypes

    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != int(parent):  # it died before we asked
        os.kill(os.getpid(), signal.SIGTERM)
