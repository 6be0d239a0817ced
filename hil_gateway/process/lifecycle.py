"""What every process of the loop does the same way: end in order when asked to."""

from __future__ import annotations

import logging
import os
import signal
import sys
from collections.abc import Sequence

PARENT_VARIABLE = "HIL_PARENT"
"""environment variable with the process identifier of the supervisor, in the processes it starts"""
EVENT_LINE = "event: "
"""how a line of the event log on standard error begins: it says nothing of why a process ended"""
PR_SET_PDEATHSIG = 1
SILENT_NS = 5_000_000_000
AGAIN_S = 0.5
"""after which an interrupt that led to nothing is repeated"""
REPEATS = 2
"""before the process is ended as it is: IPOPT takes every interrupt for a failed step"""
log = logging.getLogger(__name__)


class Interrupt:
    """SIGINT and SIGTERM as Python has the first, remembered and repeated: compiled code makes errors of its own of the
    exception, or swallows it."""

    def __init__(self) -> None:
        self.signal = 0
        """number of the newest one; 0: none"""
        handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
        self._before = {number: old for number, old in handlers.items() if old is not signal.SIG_IGN}  # by nohup
        for number in self._before:
            signal.signal(number, self)

    def __call__(self, number: int, frame: object) -> None:
        self.signal = number
        signal.signal(signal.SIGALRM, self._again)
        signal.setitimer(signal.ITIMER_REAL, AGAIN_S, AGAIN_S)
        self._repeats_left = REPEATS
        raise KeyboardInterrupt

    def over(self) -> None:
        """Nothing is under way any more."""
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _again(self, *_: object) -> None:
        if isinstance(sys.exception(), KeyboardInterrupt):  # the last one is ending what is under way
            return
        self._repeats_left -= 1
        if self._repeats_left < 0:
            signal.signal(self.signal, signal.SIG_DFL)
            os.kill(os.getpid(), self.signal)
        raise KeyboardInterrupt


class StopRequest:
    """SIGINT and SIGTERM end in order what asks between its steps; calling it says whether one has arrived."""

    def __init__(self) -> None:
        self.signal = 0
        """number of the first one; 0: none"""
        self.count = 0
        self._before = {number: signal.signal(number, self._note) for number in (signal.SIGINT, signal.SIGTERM)}

    def __call__(self) -> bool:
        return self.signal != 0

    def release(self) -> None:
        """From now on a signal does again what it did before."""
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _note(self, number: int, frame: object) -> None:
        self.signal = self.signal or number
        self.count += 1


def worth_a_line(count: int) -> bool:
    """Whether the `count`th of its kind is logged: the 1st, 2nd, 4th, 8th...; a flood must not flood the log."""
    return count & (count - 1) == 0


class SilenceNotice:
    """Says once, on the log, that nothing of `what` has ever come: a wrong endpoint looks like a quiet bus."""

    def __init__(self, what: str, endpoints: Sequence[str], now_ns: int) -> None:
        self._text = f"no {what} yet through {', '.join(endpoints) or 'no endpoint'} (zenoh.connect)"
        self._due_ns: int | None = now_ns + SILENT_NS

    def step(self, now_ns: int, received: bool) -> None:
        """Once a period; `received` whether any has come."""
        if self._due_ns is not None and (received or now_ns >= self._due_ns):
            self._due_ns = None
            if not received:
                log.warning("%s", self._text)


def end_with_parent() -> None:
    """Have the kernel send SIGTERM when the supervisor dies in any way: no orphan drives on."""
    parent = os.environ.get(PARENT_VARIABLE)
    if parent is None:
        return
    import ctypes

    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != int(parent):  # it died before we asked
        os.kill(os.getpid(), signal.SIGTERM)
